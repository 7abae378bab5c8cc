"""The model-free pipeline: background, clusters, scan matching, estimated motion, life of a track, forecast."""

from gridtrack.trackers.model_free.tracker import FactorGraphTracker, KalmanTracker

__all__ = ["FactorGraphTracker", "KalmanTracker"]
