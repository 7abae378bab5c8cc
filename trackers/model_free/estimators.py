"""Two motion regimes, steady motion and manoeuvres: an estimator for each, weighted by its likelihood.

Walkers and vehicles in steady motion keep their velocity to some cm/s, and then brake or turn within a second. One
process noise is too large for the first and too small for the second. This is a multiple-model estimator with switching
regimes (Bar-Shalom, Li and Kirubarajan 2001, section 11.6). The estimators are not mixed: if a regime becomes
improbable, its estimator is re-initialised from the other, which works for a smoother as well as for a filter.

Noise proportional to the speed can make an estimate diverge: a wrong heading causes a higher speed, the speed more
noise, and the noise a larger weight of the next wrong heading. A diverged estimator is re-initialised.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable

import numba
import numpy as np

from gridtrack.trackers.model_free.arrays import Array
from gridtrack.trackers.model_free.motion import MotionModel, Regimes, discretise, propagate, wrapped

POSE_JACOBIAN = np.eye(3, 6)
"""Jacobian of the measured pose by the state."""
IMPROBABLE = 0.02
"""Below this probability of a regime its estimator is re-initialised from the other."""


class MotionEstimator(ABC):
    """Estimator of the state (6,) of one object: x, y, heading, vx, vy, turn rate, in the fixed frame.

    Metres, radians and seconds; the heading is in [-pi, pi). A change of `mean` (6,) or `covariance` (6, 6) makes new
    arrays: caches compare their identity. Raises ValueError as `update` does.
    """

    gate: float
    """Limit of the squared Mahalanobis distance from the prediction; farther measured poses are gross errors. Infinite
    for an estimator without robust measurements."""
    restarts = 0
    """Number of numerical failures, after which the estimator was re-initialised from its last valid estimate."""
    mean: Array
    covariance: Array

    def __init__(self, pose: Array, covariance: Array, model: MotionModel) -> None:
        """The estimator of a new track, from one measured pose (3,) and its covariance (3, 3)."""
        self._step = discretise(model)
        self.reinitialise(*initial_state(*validated_measurement(pose, covariance), model))

    @abstractmethod
    def predict(self) -> None:
        """Predict the state one period ahead."""

    @abstractmethod
    def update(self, pose: Array, covariance: Array) -> None:
        """Update with a measured pose (3,): x, y, heading, and its covariance (3, 3).

        An unobserved direction has a large variance. Raises ValueError for a pose that is not finite or a covariance
        that is not positive definite.
        """

    @abstractmethod
    def reinitialise(self, mean: Array, covariance: Array) -> None:
        """Replace the estimate by this state (6,) and its covariance (6, 6), without earlier measurements."""


MakeEstimator = Callable[[Array, Array, MotionModel], MotionEstimator]
"""Makes the estimator of one object from a pose (3,), its covariance (3, 3) and the motion model."""


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
    """Whether an object just measured at `pose` (3,) cannot have this state (6,) with its covariance (6, 6).

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


def warm_up(make_estimator: MakeEstimator, model: MotionModel) -> None:
    """Compile the kernels of an estimator and of the prediction, by running each once."""
    estimator = make_estimator(np.zeros(3), np.eye(3), model)
    estimator.predict()
    estimator.update(np.zeros(3), np.eye(3))
    propagate(estimator.mean[None], estimator.covariance[None], 1, model)


class SwitchingEstimator:
    """One estimator for each regime, with the `mean` and `covariance` of the mixture.

    `probabilities` (2,): of the regimes. Raises ValueError as `update` of the estimators does.
    """

    def __init__(
        self,
        make_estimator: MakeEstimator,
        pose: Array,
        covariance: Array,
        regimes: Regimes,
    ) -> None:
        self.estimators = [make_estimator(pose, covariance, model) for model in regimes.models]
        self.gate = self.estimators[0].gate
        self._models, self._limits = regimes.models, regimes.limits
        self._begun_anew = 0
        self._switching = np.array(regimes.switching)
        self.probabilities = np.array([self._switching[1, 0], self._switching[0, 1]])
        self.probabilities /= self.probabilities.sum()
        self._mix()

    @property
    def restarts(self) -> int:
        """Number of numerical failures and divergences, after which an estimator was re-initialised."""
        return self._begun_anew + sum(estimator.restarts for estimator in self.estimators)

    def predict(self) -> None:
        """Predict the state one period ahead."""
        for estimator in self.estimators:
            estimator.predict()
        self.probabilities = self.probabilities @ self._switching
        self._mix()

    def update(self, pose: Array, covariance: Array) -> None:
        """Update with a measured pose (3,) and its covariance (3, 3)."""
        one, other = self.estimators
        predicted = one.mean, one.covariance, other.mean, other.covariance  # an update makes new arrays
        for estimator, model in zip(self.estimators, self._models, strict=True):
            estimator.update(pose, covariance)
            if has_diverged(estimator.mean, estimator.covariance, pose, self._limits):
                estimator.reinitialise(*initial_state(pose, covariance, model))
                self._begun_anew += 1
        self.probabilities = _updated_probabilities(self.probabilities, *predicted, pose, covariance, self.gate)
        if self.probabilities[0] < IMPROBABLE:
            one.reinitialise(other.mean, other.covariance)
        elif self.probabilities[1] < IMPROBABLE:
            other.reinitialise(one.mean, one.covariance)
        self._mix()

    def reinitialise(self, mean: Array, covariance: Array) -> None:
        """Replace the estimates by this state (6,) and its covariance (6, 6), without earlier measurements."""
        for estimator in self.estimators:
            estimator.reinitialise(mean, covariance)
        self._mix()

    def _mix(self) -> None:
        one, other = self.estimators
        self.mean, self.covariance = _mixture(
            one.mean, one.covariance, other.mean, other.covariance, self.probabilities[1]
        )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _mixture(mean, covariance, other_mean, other_covariance, share):  # type: ignore[no-untyped-def]
    """Mean (6,) and covariance (6, 6) of a mixture, the other component with weight `share`; headings are close."""
    difference, mixed, spread = np.empty(6), np.empty(6), np.empty((6, 6))
    for i in range(6):
        difference[i] = other_mean[i] - mean[i]
    difference[2] = wrapped(difference[2])
    for i in range(6):
        mixed[i] = mean[i] + share * difference[i]
        for j in range(6):
            spread[i, j] = (
                (1.0 - share) * covariance[i, j]
                + share * other_covariance[i, j]
                + (1.0 - share) * share * (difference[i] * difference[j])
            )
    mixed[2] = wrapped(mixed[2])
    return mixed, spread


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _updated_probabilities(probabilities, mean, covariance, other_mean, other_covariance, pose, noise, gate):  # type: ignore[no-untyped-def]
    """Bayes' rule: the probabilities (2,) of the regimes after a measured pose (3,) with covariance `noise` (3, 3)."""
    one = _log_likelihood(mean, covariance, pose, noise, gate)
    other = _log_likelihood(other_mean, other_covariance, pose, noise, gate)
    most, updated = max(one, other), np.empty(2)
    updated[0], updated[1] = probabilities[0] * math.exp(one - most), probabilities[1] * math.exp(other - most)
    total = updated[0] + updated[1]
    updated[0], updated[1] = updated[0] / total, updated[1] / total
    return updated


@numba.njit(error_model="numpy")
def _log_likelihood(mean, covariance, pose, noise, gate):  # type: ignore[no-untyped-def]
    """Log likelihood of a measured pose (3,), up to a constant; constant beyond the `gate`.

    By the Cholesky factor of the innovation's covariance.
    """
    factor, whitened = np.empty((3, 3)), np.empty(3)
    squared = log_determinant = 0.0
    for i in range(3):
        for j in range(i + 1):
            rest = covariance[i, j] + noise[i, j]
            for k in range(j):
                rest -= factor[i, k] * factor[j, k]
            factor[i, j] = math.sqrt(rest) if i == j else rest / factor[j, j]
        whitened[i] = wrapped(pose[i] - mean[i]) if i == 2 else pose[i] - mean[i]
        for k in range(i):
            whitened[i] -= factor[i, k] * whitened[k]
        whitened[i] /= factor[i, i]
        squared += whitened[i] * whitened[i]
        log_determinant += 2.0 * math.log(factor[i, i])
    return -0.5 * (min(squared, gate) + log_determinant)
