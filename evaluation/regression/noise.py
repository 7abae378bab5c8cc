"""Variation of falls between units that a few units with a large fall do not raise.

A swap test cannot find a fall in fewer than five units, however large: one in 16 swaps leaves all of four units as
they are. A second criterion therefore compares a fall with the variation of the *typical* unit. Let f_u be the fall of
the score of unit u, and w_u its share of the denominator. The weighted median of f_u is the typical fall, and what is
left of f_u has a scale that is estimated by a quantile of its absolute values (QUANTILE, over that of a normal
distribution), so that up to five of twenty units may have collapsed without an effect on it (Huber, Robust Statistics,
1981, chapter 5). It is estimated twice: for a scale that all units share, and for one that is larger where w_u is
smaller, by its root. The standard error of a set of units is the larger one that follows. It is never below that of
its cells, of which one in CELLS_TOGETHER counts: the cells of an object are found or missed together, in several
steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from gridtrack.evaluation.regression.rows import LARGEST, PairedRow
from gridtrack.evaluation.statistics.jackknife import LEAST_UNITS, Floats
from gridtrack.evaluation.statistics.training_spread import linearised, value_of

QUANTILE = 0.7
"""Quantile of the absolute deviations; of a median, units without any change would make the scale 0."""
QUANTILE_OF_NORMAL = float(ndtri(0.5 + QUANTILE / 2))
"""That quantile of a standard normal distribution."""
CELLS_TOGETHER = 25.0
"""Ten cells or more of an object, over the four to eight steps of a band."""


@dataclass(frozen=True, slots=True)
class UnitFalls:
    """Contributions (U,) of units to the fall of one row, positive where it is worse, and the units' `weights` (U,)."""

    contributions: Floats
    weights: Floats

    def standard_error(self, share: float) -> float:
        """Standard error of the fall over a set of units that have `share` of the weights; 0 for one without any."""
        counted = self.weights > 0
        if not share or not counted.any():
            return 0.0
        weights = self.weights[counted]
        own = self.contributions[counted] / weights
        left = np.abs(own - _weighted_median(own, weights))
        alike = np.quantile(left, QUANTILE) / QUANTILE_OF_NORMAL
        by_size = np.quantile(left * np.sqrt(weights), QUANTILE) / QUANTILE_OF_NORMAL
        effective = max(1.0, share / float((weights**2).sum()))
        return float(max(alike / np.sqrt(effective), by_size / np.sqrt(share)))


def _weighted_median(values: Floats, weights: Floats) -> float:
    order = np.argsort(values)
    reached = np.cumsum(weights[order]) >= weights.sum() / 2
    return float(values[order][reached.argmax()])


def unit_falls(row: PairedRow) -> UnitFalls:
    """How the fall of a row is made up of its units; the contributions add up to it."""
    then, now = row.by_unit(row.baseline)[:, None], row.by_unit(row.run)[:, None]
    value = np.nan_to_num(value_of(then.sum(axis=0)))
    fall = row.sign * (linearised(then, value) - linearised(now, value))
    whole = then[:, 0, 1]
    return UnitFalls(fall[:, 0], whole / whole.sum() if whole.sum() else whole)


def standard_error(row: PairedRow, members: NDArray[np.bool_], falls: UnitFalls) -> float:
    """Standard error of the fall over the parts `members` (P,), from the typical unit of `falls`; of few units, from
    the cells alone."""
    whole = row.baseline[:, 1]
    share = float(whole[members].sum() / whole.sum()) if whole.sum() else 0.0
    cells = _error_of_cells(row, members)
    return max(cells, falls.standard_error(share)) if len(falls.weights) >= LEAST_UNITS else cells


def _error_of_cells(row: PairedRow, members: NDArray[np.bool_]) -> float:
    """The largest standard error that a mean of cells with this value can have: v (max - v) over their number."""
    sums = row.baseline[members].sum(axis=0)
    if not sums[1]:
        return 0.0
    value = sums[0] / sums[1]
    return float(np.sqrt(CELLS_TOGETHER * value * (LARGEST[row.score] - value) / sums[1]))
