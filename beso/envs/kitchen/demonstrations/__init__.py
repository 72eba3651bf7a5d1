"""Demonstrations of the relay kitchen: recorded from a scripted player, or read from published files."""
