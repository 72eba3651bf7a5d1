"""Commands for people: benchmarks, what a policy makes of its goal, the archive."""
