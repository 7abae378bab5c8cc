"""Two regimes of motion, steady and agile: an estimator for each, and how likely each is by what it foretold.

Who walks or drives on keeps a velocity to some cm/s, and then brakes or turns within a second. One process noise for
both is too wide for the first and too narrow for the second. This is a multiple-model estimator with switching regimes
(Bar-Shalom, Li and Kirubarajan 2001, section 11.6) whose estimators are not mixed: one that is all but disproved begins
anew from the other's estimate, which a smoother can do as well as a filter.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numba
import numpy as np

from gridtrack.trackers.model_free.arrays import Array
from gridtrack.trackers.model_free.motion.estimator import MotionEstimator
from gridtrack.trackers.model_free.motion.model import wrapped
from gridtrack.trackers.model_free.motion.parameters import MotionModel, Regimes

DISPROVED = 0.02
"""Probability of a regime below which its estimator begins anew."""


class SwitchingEstimator:
    """Estimators of one motion, one a regime: a MotionEstimator; `mean` and `covariance` are those of the mixture.

    `probabilities` (2,) of the regimes. Raises ValueError as `update` of the estimators does.
    """

    def __init__(
        self,
        begin: Callable[[Array, Array, MotionModel], MotionEstimator],
        pose: Array,
        covariance: Array,
        regimes: Regimes,
    ) -> None:
        self.estimators = [begin(pose, covariance, model) for model in regimes.models]
        self.gate = self.estimators[0].gate
        self._switching = np.array(regimes.switching)
        self.probabilities = np.array([self._switching[1, 0], self._switching[0, 1]])
        self.probabilities /= self.probabilities.sum()
        self._mix()

    @property
    def restarts(self) -> int:
        """How often any of the estimators failed and began anew from its last sound estimate."""
        return sum(estimator.restarts for estimator in self.estimators)

    def predict(self) -> None:
        """Move on by one period."""
        for estimator in self.estimators:
            estimator.predict()
        self.probabilities = self.probabilities @ self._switching
        self._mix()

    def update(self, pose: Array, covariance: Array) -> None:
        """Take in a measured pose (3,) and its covariance (3, 3)."""
        one, other = self.estimators
        foretold = one.mean, one.covariance, other.mean, other.covariance  # an update makes new arrays
        one.update(pose, covariance)
        other.update(pose, covariance)
        self.probabilities = _weighed(self.probabilities, *foretold, pose, covariance, self.gate)
        if self.probabilities[0] < DISPROVED:
            one.begin_anew(other.mean, other.covariance)
        elif self.probabilities[1] < DISPROVED:
            other.begin_anew(one.mean, one.covariance)
        self._mix()

    def begin_anew(self, mean: Array, covariance: Array) -> None:
        """Forget everything but this state (6,) and its covariance (6, 6)."""
        for estimator in self.estimators:
            estimator.begin_anew(mean, covariance)
        self._mix()

    def _mix(self) -> None:
        one, other = self.estimators
        self.mean, self.covariance = _mixture(
            one.mean, one.covariance, other.mean, other.covariance, self.probabilities[1]
        )


@numba.njit(cache=True, nogil=True)
def _mixture(mean, covariance, other_mean, other_covariance, share):  # type: ignore[no-untyped-def]
    """Mean (6,) and covariance (6, 6) of two, the other with the `share`; their headings are near to each other."""
    apart = other_mean - mean
    apart[2] = wrapped(apart[2])
    mixed = mean + share * apart
    mixed[2] = wrapped(mixed[2])
    return mixed, (1.0 - share) * covariance + share * other_covariance + (1.0 - share) * share * np.outer(apart, apart)


@numba.njit(cache=True, nogil=True)
def _weighed(probabilities, mean, covariance, other_mean, other_covariance, pose, noise, gate):  # type: ignore[no-untyped-def]
    """The probabilities (2,) after a measured pose (3,), by how likely either estimate made it: Bayes' rule."""
    foretold = (
        _log_likelihood(mean, covariance, pose, noise, gate),
        _log_likelihood(other_mean, other_covariance, pose, noise, gate),
    )
    most = max(foretold)
    first, second = probabilities[0] * math.exp(foretold[0] - most), probabilities[1] * math.exp(foretold[1] - most)
    return np.array([first, second]) / (first + second)


@numba.njit
def _log_likelihood(mean, covariance, pose, noise, gate):  # type: ignore[no-untyped-def]
    """Of a measured pose (3,), but for a constant; one beyond the `gate` is as likely as one at it."""
    off = pose - mean[:3]
    off[2] = wrapped(off[2])
    spread = covariance[:3, :3] + noise
    return -0.5 * (min(off @ np.linalg.solve(spread, off), gate) + math.log(np.linalg.det(spread)))
