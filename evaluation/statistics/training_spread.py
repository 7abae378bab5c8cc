"""The spread of a score between trainings of the same tracker.

If a tracker were trained once more, the mean score of K trainings less the new one would have the variance
(1 + 1/K) s², where s² is the variance between trainings. Few trainings estimate s² badly. It is of the order of w, the
variance of one training's score that follows from the disagreement between units alone. So the estimate of s² is shrunk
towards w times the mean of s²/w over the tracker's rows of this score, and this mean counts for PRIOR_FREEDOM degrees
of freedom: a moderated t-test (Smyth, Statistical Applications in Genetics and Molecular Biology 3, 2004).
docs/regress.md: the choice of the prior and the measured error rates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gridtrack.evaluation.scoring.metrics import ratio
from gridtrack.evaluation.statistics.jackknife import Floats

PRIOR_FREEDOM = 1.5
"""Degrees of freedom of the mean ratio over a tracker's rows, added to the K - 1 of the row itself."""


@dataclass(frozen=True, slots=True)
class Spread:
    """The spread between `trainings`: the moderated standard deviation (R,) of the score, and the degrees of freedom of
    its square."""

    deviation: Floats
    trainings: int
    freedom: float

    @property
    def error(self) -> Floats:
        """Standard error (R,) of the difference between one more training and the mean of these."""
        error: Floats = self.deviation * np.sqrt(1 + 1 / self.trainings)
        return error


def spread_between(trainings: Floats, prior_freedom: float = PRIOR_FREEDOM) -> Spread:
    """The spread between K >= 2 trainings of one tracker: numerators and denominators (K, U, R, 2) of one score in U
    units and R rows.

    A row in which all trainings are equal in every unit, or have nothing to score, has a deviation of 0.
    """
    own = np.nan_to_num(value_of(trainings.sum(axis=1)).var(axis=0, ddof=1))
    by_units = _variance_by_units(trainings)
    moved = by_units > 0
    ratio = own[moved] / by_units[moved]
    prior = ratio.mean() if moved.any() else 0.0
    freedom = len(trainings) - 1 + prior_freedom
    moderated = np.zeros_like(own)
    moderated[moved] = by_units[moved] * (ratio + prior_freedom / freedom * (prior - ratio))
    return Spread(np.sqrt(moderated), len(trainings), freedom)


def value_of(sums: Floats) -> Floats:
    """The score (...) of numerators and denominators (..., 2); NaN where it is undefined."""
    return ratio(sums[..., 0], sums[..., 1])


def _variance_by_units(trainings: Floats) -> Floats:
    """The variance (R,) of the pooled score of one training that follows from the disagreement between units alone.

    NaN with one unit.

    Each unit contributes its linearised share to the score; the disagreement is the shares less their mean over
    trainings.
    """
    count, units = trainings.shape[:2]
    if units < 2:
        return np.full(trainings.shape[2], np.nan)
    shares = linearised(trainings)
    deviations = shares - shares.mean(axis=0)
    variance: Floats = (deviations**2).sum(axis=(0, 1)) / (count - 1) * units / (units - 1)
    return variance


def linearised(sums: Floats, value: Floats | None = None) -> Floats:
    """Contribution (..., U, R) of each of U units to the pooled score less `value` (..., R), of sums (..., U, R, 2).

    `value`: None is the pooled score itself, from which the contributions add up to 0.
    """
    pooled = sums.sum(axis=-3)
    value = np.nan_to_num(value_of(pooled)) if value is None else value
    whole = pooled[..., None, :, 1]
    part: Floats = np.zeros(sums.shape[:-1])
    np.divide(sums[..., 0] - value[..., None, :] * sums[..., 1], whole, out=part, where=whole > 0)
    return part
