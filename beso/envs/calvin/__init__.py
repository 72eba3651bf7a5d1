"""The CALVIN play table: a Panda arm, a table with door, drawer, button, switch and two lights, three blocks."""
