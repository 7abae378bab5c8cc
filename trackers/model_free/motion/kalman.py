"""The extended Kalman filter of an object's motion, by filterpy."""

from __future__ import annotations

import math

import numba
import numpy as np
from filterpy.kalman import update

from gridtrack.common.geometry import wrap_angle
from gridtrack.trackers.model_free.arrays import Array
from gridtrack.trackers.model_free.motion.estimator import checked, first_state
from gridtrack.trackers.model_free.motion.model import advance, discretise, wrapped
from gridtrack.trackers.model_free.motion.parameters import MotionModel

MEASURED = np.eye(3, 6)
"""The measured pose as a function of the state."""


class KalmanEstimator:
    """Extended Kalman filter: a MotionEstimator. `mean` (6,) and `covariance` (6, 6) are those of the newest frame.

    The prediction is linearised at the mean; the measurement is linear, its heading taken at the turn nearest to the
    mean's. Raises ValueError as `update` does.
    """

    gate = math.inf
    restarts = 0

    def __init__(self, pose: Array, covariance: Array, model: MotionModel) -> None:
        self._step = discretise(model)
        self.mean, self.covariance = first_state(*checked(pose, covariance), model)

    def predict(self) -> None:
        """Move on by one period."""
        self._settle(*advance(self.mean, self.covariance, self._step))

    def update(self, pose: Array, covariance: Array) -> None:
        """Take in a measured pose (3,) and its covariance (3, 3); filterpy's update is in Joseph's form."""
        pose, covariance = checked(pose, covariance)
        nearest = np.array([pose[0], pose[1], self.mean[2] + wrap_angle(pose[2] - self.mean[2])])
        self._settle(*update(self.mean, self.covariance, nearest, covariance, MEASURED))

    def begin_anew(self, mean: Array, covariance: Array) -> None:
        """Forget everything but this state (6,) and its covariance (6, 6)."""
        self.mean, self.covariance = mean.copy(), covariance.copy()

    def _settle(self, mean: Array, covariance: Array) -> None:
        _settled(mean, covariance)
        self.mean, self.covariance = mean, covariance


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _settled(mean, covariance):  # type: ignore[no-untyped-def]
    """Wrap the heading of `mean` (6,) and make `covariance` (6, 6) symmetric, in place."""
    mean[2] = wrapped(mean[2])
    for i in range(6):
        for j in range(i):
            covariance[i, j] = covariance[j, i] = 0.5 * (covariance[i, j] + covariance[j, i])
