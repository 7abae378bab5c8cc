"""The floors of every comparison, which a tracker must beat: persistence, static map, blank."""
