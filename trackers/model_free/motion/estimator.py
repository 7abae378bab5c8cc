"""The interface of motion estimators, the checks of measured poses and of estimates, and the initial state."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

import numba
import numpy as np

from gridtrack.trackers.model_free.arrays import Array
from gridtrack.trackers.model_free.motion.model import propagate
from gridtrack.trackers.model_free.motion.parameters import MotionModel

POSE_JACOBIAN = np.eye(3, 6)
"""Jacobian of the measured pose by the state."""


class MotionEstimator(Protocol):
    """Estimator of the state (6,) of one object: x, y, heading, vx, vy, turn rate, in the fixed frame.

    Metres, radians and seconds; the heading is in [-pi, pi). A change of `mean` or `covariance` makes new arrays:
    caches compare their identity.
    """

    @property
    def mean(self) -> Array:
        """State (6,)."""
        ...

    @property
    def covariance(self) -> Array:
        """Covariance (6, 6) of the state."""
        ...

    @property
    def gate(self) -> float:
        """Squared Mahalanobis distance from the prediction beyond which a measured pose is a gross error.

        Infinite for an estimator without robust measurements.
        """
        ...

    @property
    def restarts(self) -> int:
        """How often the estimator failed numerically and was re-initialised from its last valid estimate."""
        ...

    def predict(self) -> None:
        """Predict the state one period ahead."""
        ...

    def update(self, pose: Array, covariance: Array) -> None:
        """Update with a measured pose (3,): x, y, heading, and its covariance (3, 3).

        An unobserved direction has a large variance. Raises ValueError for a pose that is not finite or a covariance
        that is not positive definite.
        """
        ...

    def reinitialise(self, mean: Array, covariance: Array) -> None:
        """Replace the estimate by this state (6,) and its covariance (6, 6), without earlier measurements."""
        ...


def validated_measurement(pose: Array, covariance: Array) -> tuple[Array, Array]:
    """The pose (3,) and its covariance (3, 3), float64; raises ValueError if they are not valid."""
    pose = np.ascontiguousarray(pose, np.float64)
    covariance = np.ascontiguousarray(covariance, np.float64)
    if pose.shape != (3,) or not all(map(math.isfinite, pose.tolist())):
        raise ValueError(f"measured pose: {pose.tolist()}; give x, y and heading, finite")
    if covariance.shape != (3, 3) or not is_positive_definite(covariance):
        raise ValueError(
            f"covariance of a measured pose: {covariance.tolist()}; give a symmetric, positive definite (3, 3), "
            "with a large variance in directions that were not measured"
        )
    return pose, covariance


@numba.njit(cache=True, nogil=True, error_model="numpy")
def is_positive_definite(matrix):  # type: ignore[no-untyped-def]
    """Whether a matrix (N, N) is finite, symmetric and positive definite (it has a Cholesky factor)."""
    factor = np.zeros_like(matrix)
    for i in range(len(matrix)):
        for j in range(i + 1):
            if not abs(matrix[i, j] - matrix[j, i]) <= 1e-9 * np.sqrt(abs(matrix[i, i] * matrix[j, j])):
                return False
            rest = matrix[i, j]
            for k in range(j):
                rest -= factor[i, k] * factor[j, k]
            if i > j:
                factor[i, j] = rest / factor[j, j]
            elif 0.0 < rest < np.inf:
                factor[i, i] = np.sqrt(rest)
            else:
                return False
    return True


@numba.njit(cache=True, nogil=True, error_model="numpy")
def has_diverged(mean, covariance, pose, limits):  # type: ignore[no-untyped-def]
    """Whether a state (6,) with its covariance (6, 6) cannot be that of an object just measured at `pose` (3,).

    It is outside the StateLimits, or not finite, or its covariance is not positive definite.
    """
    away, speed = math.hypot(mean[0] - pose[0], mean[1] - pose[1]), math.hypot(mean[3], mean[4])
    moves = away <= limits.distance_m and speed <= limits.speed and abs(mean[5]) <= limits.turn_rate
    return not (moves and math.isfinite(mean[2]) and is_positive_definite(covariance))


def initial_state(pose: Array, covariance: Array, model: MotionModel) -> tuple[Array, Array]:
    """Mean (6,) and covariance (6, 6) of a new track, from one measured pose."""
    mean, spread = np.zeros(6), np.zeros((6, 6))
    mean[:3], spread[:3, :3] = pose, covariance
    spread[3, 3] = spread[4, 4] = model.initial_speed**2
    spread[5, 5] = model.initial_turn_rate**2
    return mean, spread


def warm_up(estimator: Callable[[Array, Array, MotionModel], MotionEstimator], model: MotionModel) -> None:
    """Compile the kernels of an estimator and of the prediction, by running each once."""
    track = estimator(np.zeros(3), np.eye(3), model)
    track.predict()
    track.update(np.zeros(3), np.eye(3))
    propagate(track.mean[None], track.covariance[None], 1, model)
