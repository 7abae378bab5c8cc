"""Trackers with several trainings: the spread of a score between trainings, and differences that are judged with it.

The difference of two trackers is the difference of the mean scores of their trainings. Its variance is the sum of the
variance over units (the jackknife of the difference of means, with the effective number of units less one as its
degrees of freedom) and the variances of both means over trainings, s² / K. The degrees of freedom of the sum are
Satterthwaite's (Biometrics Bulletin 2, 1946). Both terms contain the variance that units and trainings share: if
trainings differ only on single units, intervals are too long (`studies/coverage.py`, docs/statistics.md).

Few trainings estimate s² badly. It is of the order of w, the variance of one training's score that follows from the
disagreement between units alone. So the estimate of s² is shrunk towards w times the mean of s²/w over the tracker's
rows of this score, and this mean counts for PRIOR_FREEDOM degrees of freedom: a moderated t-test (Smyth, Statistical
Applications in Genetics and Molecular Biology 3, 2004). docs/regress.md: the choice of the prior and the error rates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gridtrack.evaluation.scores.definition import Floats
from gridtrack.evaluation.statistics.jackknife import (
    LEAST_UNITS,
    LEVEL,
    IntervalEstimate,
    Replicates,
    degrees_of_freedom,
    difference,
    difference_of,
)

LEAST_TRAININGS = 3
"""With fewer the spread between trainings of a tracker is hardly known."""
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


def spread_between(trainings: Sequence[Replicates]) -> Spread:
    """The spread between K >= 2 trainings of one tracker: one score in R rows, of the same units.

    A row in which all trainings are equal in every unit, or have nothing to score, has a deviation of 0.
    """
    values = np.nan_to_num(np.stack([one.value for one in trainings]))
    own, by_units = values.var(axis=0, ddof=1), _variance_by_units(trainings)
    moved = by_units > 0
    ratio = own[moved] / by_units[moved]
    prior = ratio.mean() if moved.any() else 0.0
    freedom = len(trainings) - 1 + PRIOR_FREEDOM
    moderated = np.zeros_like(own)
    moderated[moved] = by_units[moved] * (ratio + PRIOR_FREEDOM / freedom * (prior - ratio))
    return Spread(np.sqrt(moderated), len(trainings), freedom)


def contributions(found: Replicates) -> Floats:
    """Linearised contribution (U, R) of each unit to the value; contributions to a ratio of sums add up to 0."""
    total = found.size.sum(axis=0)
    share = np.divide(found.size, total, out=np.zeros(found.size.shape), where=total > 0)  # sizes may be integers
    shares: Floats = np.nan_to_num(found.value - found.without) * (1.0 - share)
    return shares


def _variance_by_units(trainings: Sequence[Replicates]) -> Floats:
    """The variance (R,) of the score of one training that follows from the disagreement between units alone.

    NaN with one unit. The disagreement is the contributions of units less their mean over trainings.
    """
    units = trainings[0].units
    if units < 2:
        return np.full(trainings[0].value.shape, np.nan)
    shares = np.stack([contributions(one) for one in trainings])
    deviations = shares - shares.mean(axis=0)
    variance: Floats = (deviations**2).sum(axis=(0, 1)) / (len(trainings) - 1) * units / (units - 1)
    return variance


@dataclass(frozen=True, slots=True)
class Trainings:
    """The K trainings of one tracker in R rows, of the same units.

    `learned`: whether it has weights. A tracker without weights has one training, which another one would repeat.
    """

    each: tuple[Replicates, ...]
    learned: bool

    @property
    def mean(self) -> Replicates:
        """The mean of the trainings."""
        value, without, size = (
            np.mean([getattr(one, name) for one in self.each], axis=0) for name in ("value", "without", "size")
        )
        return Replicates(value, without, size)

    @property
    def spread_known(self) -> bool:
        """Whether the variance of the mean over trainings can be estimated well enough for an interval."""
        return len(self.each) >= LEAST_TRAININGS or not self.learned

    def variance(self) -> tuple[Floats, float]:
        """The variance (R,) of the mean over trainings, and the degrees of freedom of its estimate."""
        if len(self.each) == 1:
            return np.zeros(self.each[0].value.shape), 1.0
        spread = spread_between(self.each)
        return spread.deviation**2 / spread.trainings, spread.freedom


def training_differences(own: Trainings, reference: Trainings, level: float = LEVEL) -> IntervalEstimate:
    """Mean score of `own` less the mean of `reference` (R,), with intervals over units and trainings; both of the same
    units.

    NaN without LEAST_UNITS units, or where the spread between trainings is not known.
    """
    mine, theirs = own.mean, reference.mean
    value, units = mine.value - theirs.value, mine.units
    if units < LEAST_UNITS or not (own.spread_known and reference.spread_known):
        return IntervalEstimate.unknown(value)
    without = mine.without - theirs.without
    over_units = (units - 1) / units * ((without - without.mean(axis=0)) ** 2).sum(axis=0)
    of_units = over_units, degrees_of_freedom(mine.size, theirs.size)
    variance, freedom = total_variance(of_units, own.variance(), reference.variance())
    return difference_of(value, np.sqrt(variance), freedom, level)


def one_more(own: Replicates, trainings: Sequence[Replicates]) -> tuple[IntervalEstimate, Spread | None]:
    """The score of one more training less the mean of `trainings` (...), of the same units; and their spread.

    With several trainings the variance includes the spread between them; with one it is not known (None), and the
    difference is that of two trackers.
    """
    mean = Trainings(tuple(trainings), learned=True).mean
    if len(trainings) == 1:
        return difference(own, mean), None
    units = own.units
    without = np.nan_to_num(own.without - mean.without)
    over_units = (units - 1) / units * ((without - without.mean(axis=0)) ** 2).sum(axis=0)
    spread = spread_between(trainings)
    of_units = over_units, degrees_of_freedom(own.size, mean.size)
    variance, freedom = total_variance(of_units, (spread.error**2, spread.freedom))
    return difference_of(own.value - mean.value, np.sqrt(variance), freedom), spread


def total_variance(*parts: tuple[Floats, Floats | float]) -> tuple[Floats, Floats]:
    """The sum (...) of variances, and its degrees of freedom (Satterthwaite 1946)."""
    variance = np.asarray(sum(part for part, _ in parts))
    squared = sum(part**2 / freedom for part, freedom in parts)
    with np.errstate(divide="ignore", invalid="ignore"):
        freedom = np.where(variance > 0, variance**2 / squared, 1.0)
    return variance, freedom
