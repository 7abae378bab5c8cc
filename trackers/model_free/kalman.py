"""The `kalman` tracker: the model-free pipeline with extended Kalman filters."""

from gridtrack.trackers.model_free.motion.kalman import KalmanEstimator
from gridtrack.trackers.model_free.tracker import ModelFreeTracker


class KalmanTracker(ModelFreeTracker):
    """The pipeline with extended Kalman filters."""

    estimator = staticmethod(KalmanEstimator)
