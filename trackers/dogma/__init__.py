"""The particle grid: Dempster-Shafer masses of every cell, and particles that know where the occupied mass is going."""

from gridtrack.trackers.dogma.tracker import DogmaTracker

__all__ = ["DogmaTracker"]
