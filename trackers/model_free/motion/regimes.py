"""Two motion regimes, steady motion and manoeuvres: an estimator for each, weighted by its likelihood.

Walkers and vehicles in steady motion keep their velocity to some cm/s, and then brake or turn within a second. One
process noise is too large for the first and too small for the second. This is a multiple-model estimator with switching
regimes (Bar-Shalom, Li and Kirubarajan 2001, section 11.6) without mixing of the estimators: one whose regime becomes
improbable is re-initialised from the other, which is possible for a smoother as well as for a filter.

Noise that is proportional to the speed lets an estimate diverge: a wrong heading gives it a higher speed, which gives
it more noise, which gives the next wrong heading more weight. An estimator that has diverged begins anew.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numba
import numpy as np

from gridtrack.trackers.model_free.arrays import Array
from gridtrack.trackers.model_free.motion.estimator import MotionEstimator, has_diverged, initial_state
from gridtrack.trackers.model_free.motion.model import wrapped
from gridtrack.trackers.model_free.motion.parameters import MotionModel, Regimes

IMPROBABLE = 0.02
"""Probability of a regime below which its estimator is re-initialised from the other."""


class SwitchingEstimator:
    """One estimator for each regime: a MotionEstimator; `mean` and `covariance` are those of the mixture.

    `probabilities` (2,) are those of the regimes. Raises ValueError as `update` of the estimators does.
    """

    def __init__(
        self,
        make_estimator: Callable[[Array, Array, MotionModel], MotionEstimator],
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
        """How often any of the estimators failed numerically or diverged, and was re-initialised."""
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


@numba.njit(cache=True, nogil=True)
def _mixture(mean, covariance, other_mean, other_covariance, share):  # type: ignore[no-untyped-def]
    """Mean (6,) and covariance (6, 6) of a mixture, the other component with weight `share`; headings are close."""
    difference = other_mean - mean
    difference[2] = wrapped(difference[2])
    mixed = mean + share * difference
    mixed[2] = wrapped(mixed[2])
    return mixed, (1.0 - share) * covariance + share * other_covariance + (1.0 - share) * share * np.outer(
        difference, difference
    )


@numba.njit(cache=True, nogil=True)
def _updated_probabilities(probabilities, mean, covariance, other_mean, other_covariance, pose, noise, gate):  # type: ignore[no-untyped-def]
    """Bayes' rule: the probabilities (2,) of the regimes after a measured pose (3,) with covariance `noise` (3, 3)."""
    predicted = (
        _log_likelihood(mean, covariance, pose, noise, gate),
        _log_likelihood(other_mean, other_covariance, pose, noise, gate),
    )
    most = max(predicted)
    first, second = probabilities[0] * math.exp(predicted[0] - most), probabilities[1] * math.exp(predicted[1] - most)
    return np.array([first, second]) / (first + second)


@numba.njit
def _log_likelihood(mean, covariance, pose, noise, gate):  # type: ignore[no-untyped-def]
    """Log likelihood of a measured pose (3,), up to a constant; constant beyond the `gate`."""
    innovation = pose - mean[:3]
    innovation[2] = wrapped(innovation[2])
    spread = covariance[:3, :3] + noise
    return -0.5 * (min(innovation @ np.linalg.solve(spread, innovation), gate) + math.log(np.linalg.det(spread)))
