"""The extended Kalman filter of an object's motion, by filterpy."""

from __future__ import annotations

import math

import numba
import numpy as np
from filterpy.kalman import update

from gridtrack.common.geometry import wrap_angle
from gridtrack.trackers.model_free.arrays import Array
from gridtrack.trackers.model_free.estimators import POSE_JACOBIAN, MotionEstimator, validated_measurement
from gridtrack.trackers.model_free.motion import predict_state, wrapped
from gridtrack.trackers.model_free.tracker import ModelFreeTracker


class KalmanEstimator(MotionEstimator):
    """Extended Kalman filter; `mean` (6,) and `covariance` (6, 6) are at the newest frame.

    The prediction is linearised at the mean. The measurement is linear; its heading is unwrapped to the heading of the
    mean.
    """

    gate = math.inf

    def predict(self) -> None:
        """Predict the state one period ahead."""
        self._store(*predict_state(self.mean, self.covariance, self._step))

    def update(self, pose: Array, covariance: Array) -> None:
        """Update with a measured pose (3,) and its covariance (3, 3); filterpy uses the Joseph form."""
        pose, covariance = validated_measurement(pose, covariance)
        measured = np.array([pose[0], pose[1], self.mean[2] + wrap_angle(pose[2] - self.mean[2])])
        self._store(*update(self.mean, self.covariance, measured, covariance, POSE_JACOBIAN))

    def reinitialise(self, mean: Array, covariance: Array) -> None:
        """Replace the estimate by this state (6,) and its covariance (6, 6), without earlier measurements."""
        self.mean, self.covariance = mean.copy(), covariance.copy()

    def _store(self, mean: Array, covariance: Array) -> None:
        _normalise_state(mean, covariance)
        self.mean, self.covariance = mean, covariance


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _normalise_state(mean, covariance):  # type: ignore[no-untyped-def]
    """Wrap the heading of `mean` (6,) and make `covariance` (6, 6) symmetric, in place."""
    mean[2] = wrapped(mean[2])
    for i in range(6):
        for j in range(i):
            covariance[i, j] = covariance[j, i] = 0.5 * (covariance[i, j] + covariance[j, i])


class KalmanTracker(ModelFreeTracker):
    """The pipeline with extended Kalman filters."""

    estimator = staticmethod(KalmanEstimator)
