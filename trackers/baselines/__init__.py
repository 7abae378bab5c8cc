"""The floor of every comparison: persistence, static map, blank."""
