"""The model-free pipeline: static background, clusters, gated association, Kalman filter, life of a track, forecast."""

from gridtrack.trackers.model_free.tracker import KalmanTracker

__all__ = ["KalmanTracker"]
