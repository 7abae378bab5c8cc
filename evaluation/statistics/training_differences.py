"""Differences between trackers with several trainings each, judged over units and over trainings.

The difference of two trackers is that of the mean scores of their trainings. Its variance is the sum of the variance
over units (the jackknife of the difference of means, with the effective number of units less one as its degrees of
freedom) and the variances of both means over trainings, s² / K; the degrees of freedom of the sum are Satterthwaite's
(Biometrics Bulletin 2, 1946). The part of the variance that units and trainings share is in both terms: intervals are a
little too long rather than too short (`studies/coverage.py`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gridtrack.evaluation.statistics.jackknife import (
    LEAST_UNITS,
    LEVEL,
    Floats,
    PairedDifferences,
    degrees_of_freedom,
    difference_of,
)
from gridtrack.evaluation.statistics.training_spread import spread_between, value_of

LEAST_TRAININGS = 3
"""With fewer the spread between trainings of a tracker is hardly known."""


@dataclass(frozen=True, slots=True)
class Trainings:
    """The trainings of one tracker: `sums` (K, U, R, 2), numerator and denominator of F1 in U units and R rows.

    `learned`: whether it has weights. A tracker without weights has one training, which another one would repeat.
    """

    sums: Floats
    learned: bool

    @property
    def mean(self) -> Floats:
        """The mean (R,) of the pooled scores."""
        mean: Floats = value_of(self.sums.sum(axis=1)).mean(axis=0)
        return mean

    @property
    def mean_without(self) -> Floats:
        """The mean (U, R) without each unit in turn."""
        mean: Floats = value_of(self.sums.sum(axis=1, keepdims=True) - self.sums).mean(axis=0)
        return mean

    @property
    def spread_known(self) -> bool:
        """Whether the variance of the mean over trainings can be estimated well enough for an interval."""
        return len(self.sums) >= LEAST_TRAININGS or not self.learned

    @property
    def sizes(self) -> Floats:
        """How much each unit counts (U, R): the denominator of F1, the mean of the trainings."""
        sizes: Floats = self.sums[..., 1].mean(axis=0)
        return sizes

    def variance(self) -> tuple[Floats, float]:
        """The variance (R,) of the mean over trainings, and the degrees of freedom of its estimate."""
        if len(self.sums) == 1:
            return np.zeros(self.sums.shape[2]), 1.0
        spread = spread_between(self.sums)
        return spread.deviation**2 / spread.trainings, spread.freedom


def training_differences(own: Trainings, reference: Trainings, level: float = LEVEL) -> PairedDifferences:
    """Mean score of `own` less that of `reference` (R,), with intervals over units and trainings; both of the same
    units.

    NaN without LEAST_UNITS units, or where the spread between trainings is not known.
    """
    value = own.mean - reference.mean
    units = own.sums.shape[1]
    if units < LEAST_UNITS or not (own.spread_known and reference.spread_known):
        nothing = np.full_like(value, np.nan)
        return PairedDifferences(value, nothing, nothing.copy(), nothing.copy())
    without = own.mean_without - reference.mean_without
    over_units = (units - 1) / units * ((without - without.mean(axis=0)) ** 2).sum(axis=0)
    parts = [(over_units, degrees_of_freedom(own.sizes, reference.sizes)), own.variance(), reference.variance()]
    variance = np.sum([part for part, _ in parts], axis=0)
    squared = np.sum([part**2 / freedom for part, freedom in parts], axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        freedom = np.where(variance > 0, variance**2 / squared, 1.0)
    return difference_of(value, np.sqrt(variance), freedom, level)
