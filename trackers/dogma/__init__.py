"""The particle grid: Dempster-Shafer masses of the cells, and particles that carry the velocities."""

from gridtrack.trackers.dogma.tracker import DogmaTracker

__all__ = ["DogmaTracker"]
