"""State estimators of one object's motion, behind one interface, and the forecast of all objects' motions."""

from gridtrack.trackers.model_free.motion.estimator import MotionEstimator, warm_up
from gridtrack.trackers.model_free.motion.factor_graph import FactorGraphEstimator
from gridtrack.trackers.model_free.motion.kalman import KalmanEstimator
from gridtrack.trackers.model_free.motion.model import MotionModel, propagate
from gridtrack.trackers.model_free.motion.regimes import Regimes, SwitchingEstimator

__all__ = [
    "FactorGraphEstimator",
    "KalmanEstimator",
    "MotionEstimator",
    "MotionModel",
    "Regimes",
    "SwitchingEstimator",
    "propagate",
    "warm_up",
]
