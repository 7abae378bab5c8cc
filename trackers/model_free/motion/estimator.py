"""What a track asks of the estimator of its motion, and what every estimator asks of a measured pose."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

import numba
import numpy as np

from gridtrack.trackers.model_free.arrays import Array
from gridtrack.trackers.model_free.motion.model import propagate
from gridtrack.trackers.model_free.motion.parameters import MotionModel


class MotionEstimator(Protocol):
    """Where an object is and how it moves; state (6,): x, y, heading, vx, vy, turn rate, in the grid frame.

    Metres, radians and seconds; the heading is in [-pi, pi). What changes `mean` or `covariance` makes new arrays: who
    has kept one knows by its identity whether it still holds.
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
        """The squared Mahalanobis distance from its prediction beyond which a measured pose is taken for a gross error.

        Infinite where every measurement is believed.
        """
        ...

    @property
    def restarts(self) -> int:
        """How often the estimator failed and began anew from its last sound estimate."""
        ...

    def predict(self) -> None:
        """Move on by one period."""
        ...

    def update(self, pose: Array, covariance: Array) -> None:
        """Take in a measured pose (3,): x, y, heading, and its covariance (3, 3).

        A direction that the measurement says nothing of has a large variance. Raises ValueError for a pose that is
        not finite or a covariance that is not positive definite.
        """
        ...

    def begin_anew(self, mean: Array, covariance: Array) -> None:
        """Forget everything but this state (6,) and its covariance (6, 6)."""
        ...


def checked(pose: Array, covariance: Array) -> tuple[Array, Array]:
    """The pose (3,) and its covariance (3, 3), float64; raises ValueError if they are not those of a measurement."""
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
    """Whether a matrix (N, N) is finite, symmetric and has a Cholesky factor."""
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


def first_state(pose: Array, covariance: Array, model: MotionModel) -> tuple[Array, Array]:
    """Mean (6,) and covariance (6, 6) of a new track, of which only a pose has been measured."""
    mean, spread = np.zeros(6), np.zeros((6, 6))
    mean[:3], spread[:3, :3] = pose, covariance
    spread[3, 3] = spread[4, 4] = model.initial_speed**2
    spread[5, 5] = model.initial_turn_rate**2
    return mean, spread


def warm_up(estimator: Callable[[Array, Array, MotionModel], MotionEstimator], model: MotionModel) -> None:
    """Do everything once, so that what is compiled or loaded on first use has been: a tracker calls it at its start."""
    track = estimator(np.zeros(3), np.eye(3), model)
    track.predict()
    track.update(np.zeros(3), np.eye(3))
    propagate(track.mean[None], track.covariance[None], 1, model)
