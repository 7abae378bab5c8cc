"""The `factor-graph` tracker: the model-free pipeline with fixed-lag smoothers."""

from gridtrack.trackers.model_free.motion.factor_graph import FactorGraphEstimator
from gridtrack.trackers.model_free.tracker import ModelFreeTracker


class FactorGraphTracker(ModelFreeTracker):
    """The pipeline with fixed-lag smoothers, whose measurements are robust."""

    estimator = staticmethod(FactorGraphEstimator)
