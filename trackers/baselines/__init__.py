"""The floor of every comparison: persistence, static map, blank. A tracker that does not beat them has not tracked."""

from gridtrack.trackers.baselines.blank import BlankTracker
from gridtrack.trackers.baselines.persistence import PersistenceTracker
from gridtrack.trackers.baselines.static_map import StaticMapTracker

__all__ = ["BlankTracker", "PersistenceTracker", "StaticMapTracker"]
