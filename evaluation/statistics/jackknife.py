"""Intervals of scores, and paired differences of two trackers, by the jackknife over statistical units.

A unit is a whole recording, or a block of time longer than the autocorrelation of the frames (`units`). How the
method was chosen, and its coverage: docs/statistics.md, `studies/coverage.py`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy  # loads scipy.special at its first use: most processes make no interval
from numpy.typing import NDArray

from gridtrack.evaluation.scores.definition import Floats, Measure, Ratio, Scale, Sums, divided, value_of

Value = Callable[[Sums], Mapping[str, Ratio | Measure | Floats]]
"""The outputs of a score from sums (..., P)."""
LEVEL = 0.95
ALPHA = 0.05
"""Significance level of a test."""
LEAST_UNITS = 20
"""With fewer units no interval is computed: no method that was tried reaches its nominal coverage there."""
LEAST_AGREEING = 6
"""Units that agree exactly have no spread to go by: with fewer than six a sign test cannot be significant."""
TOO_SHORT = "too short for an interval"
HALF_A_COUNT = 0.5
"""Added to counts of cells or events before the logarithm. A sum of losses is no count: half a nat may be most of
it."""
WITHIN_ROUNDING = 1e-9
"""Smaller differences count as zero."""
_SMALLEST_SHARE = 1e-9
"""A sum that is no count is, before the logarithm, no smaller share of that over all units."""


@dataclass(frozen=True, slots=True)
class IntervalEstimate:
    """A value (...), the ends of its interval, and the p-value of no difference where it is one; NaN if unknown."""

    value: Floats
    low: Floats
    high: Floats
    p: Floats

    @classmethod
    def unknown(cls, value: Floats) -> IntervalEstimate:
        """A value without an interval."""
        return cls(value, *(np.full_like(value, np.nan) for _ in range(3)))

    def at(self, *index: int) -> IntervalEstimate:
        """The estimate at one index of each of the first axes."""
        return IntervalEstimate(self.value[index], self.low[index], self.high[index], self.p[index])


@dataclass(frozen=True, slots=True)
class Replicates:
    """A value (...) of all units together, and its values (U, ...) without each of the units.

    `size` (U, ...): how much each unit counts, for the effective number of units. `ratio`: the sums (U, ...) of the
    units, of a value that is a ratio of sums.
    """

    value: Floats
    without: Floats
    size: Floats
    ratio: Ratio | None = None

    @property
    def units(self) -> int:
        """The number of units."""
        return len(self.without)

    def at(self, *index: Any) -> Replicates:
        """The replicates at an index, or at several, of each of the first axes of the value."""
        return Replicates(self.value[index], self.without[:, *index], self.size[:, *index])

    def minus(self, other: Replicates) -> Replicates:
        """This value less another one of the same units, itself a value to compare."""
        size = np.minimum(self.size, other.size)
        return Replicates(self.value - other.value, self.without - other.without, size)


def replicates(value: Value, groups: Callable[[], Iterable[Sums]], total: Sums) -> dict[str, Replicates]:
    """The outputs of a score that are ratios or measures, of the sums (U, ..., P) of the units of each group.

    `total` (..., P) are the sums of all units. `groups()` goes through the units group by group, twice where an output
    is a measure: its value without a unit is computed from all sums less the unit's.
    """
    by_unit: dict[str, list[Ratio | Measure]] = {}
    for sums in groups():
        for name, output in value(sums).items():
            if isinstance(output, Ratio | Measure):
                by_unit.setdefault(name, []).append(output)
    found: dict[str, Replicates] = {}
    measures: list[str] = []
    for name, outputs in by_unit.items():
        ratios = [output for output in outputs if isinstance(output, Ratio)]
        if ratios:
            found[name] = ratio_replicates(_joined(ratios))
        else:
            measures.append(name)
    if measures:
        pooled = value(total)
        each = [value(Sums(total.values - own, total.parts)) for sums in groups() for own in sums.values]
        for name in measures:
            without = np.stack([value_of(one[name]) for one in each])
            size = np.concatenate([output.size for output in by_unit[name] if isinstance(output, Measure)])
            found[name] = Replicates(value_of(pooled[name]), without, size)
    return found


def _joined(ratios: Sequence[Ratio]) -> Ratio:
    part, whole = (np.concatenate([getattr(one, name) for one in ratios]) for name in ("part", "whole"))
    supports = [one.support for one in ratios if one.support is not None]
    return Ratio(part, whole, np.concatenate(supports) if supports else None, ratios[0].counted)


def ratio_replicates(ratio: Ratio) -> Replicates:
    """The replicates of a ratio of the sums (U, ...) of units. It is undefined if the sum of its support is 0."""
    whole = ratio.whole if ratio.support is None else ratio.whole * (ratio.support.sum(axis=0) > 0)
    value = divided(ratio.part.sum(axis=0), whole.sum(axis=0))
    without = divided(_without_each(ratio.part), _without_each(whole))
    return Replicates(value, without, whole, Ratio(ratio.part, whole, counted=ratio.counted))


def interval(found: Replicates, scale: Scale, level: float = LEVEL) -> IntervalEstimate:
    """The value with its confidence interval, which is symmetric on `scale`.

    The jackknife over units of the log odds, of the logarithm, or of the value, with Student's t: its degrees of
    freedom are the effective number of units less one (Kish 1965). The interval is NaN with fewer than LEAST_UNITS, and
    where the value is undefined, also without one of the units.
    """
    if not scale or found.units < LEAST_UNITS:
        return IntervalEstimate.unknown(found.value)
    if scale == "linear":
        error = _standard_error(np.nan_to_num(found.without))
        return difference_of(found.value, error, degrees_of_freedom(found.size), level)
    low, high = (_interval_of_ratio if found.ratio else _interval_of_measure)(found, scale, level)
    return IntervalEstimate(found.value, low, high, np.full_like(found.value, np.nan))


def _interval_of_ratio(found: Replicates, scale: Scale, level: float) -> tuple[Floats, Floats]:
    """Half a count is added to each sum of the odds if both are counts. Where the value is 0 in all units, or 1 in
    all, the interval is that point; NaN if fewer than LEAST_AGREEING effective units agree.
    """
    assert found.ratio is not None
    part, whole, counted = found.ratio.part, found.ratio.whole, found.ratio.counted and scale == "odds"
    other, back = (whole - part, scipy.special.expit) if scale == "odds" else (whole, np.exp)
    of_part, of_other = (_log_without_each(sums, counted=counted) for sums in (part, other))
    freedom = degrees_of_freedom(part, other)
    reach = _quantile(freedom, level) * _standard_error(of_part - of_other)
    with np.errstate(divide="ignore", invalid="ignore"):
        centre = np.log(part.sum(axis=0)) - np.log(other.sum(axis=0))
    low, high = (back(centre + side * reach) for side in (-1, 1))
    agreed = (part.sum(axis=0) == 0) | (other.sum(axis=0) == 0)
    unknown = np.isnan(found.value) | (agreed & (freedom < LEAST_AGREEING - 1))
    low, high = (np.where(unknown, np.nan, np.where(agreed, found.value, end)) for end in (low, high))
    return low, high


def _interval_of_measure(found: Replicates, scale: Scale, level: float) -> tuple[Floats, Floats]:
    """Half a count is added to each side of the odds: the size of a unit is its number of events. Where the value is 0
    in all units, or 1 in all, the interval is that point; NaN on a logarithmic scale, also without one of the units.
    """
    forth, back = (scipy.special.logit, scipy.special.expit) if scale == "odds" else (np.log, np.exp)
    with np.errstate(divide="ignore", invalid="ignore"):
        if scale == "odds":
            events = _without_each(found.size)
            sides = (found.without * events, (1 - found.without) * events)
            of_value, of_other = (np.log(np.maximum(side, 0.0) + HALF_A_COUNT) for side in sides)
            error = _standard_error(of_value - of_other)
        else:
            error = _standard_error(np.log(found.without))
        centre = forth(found.value)
    reach = _quantile(degrees_of_freedom(found.size), level) * error
    low, high = (np.where(np.isnan(found.value), np.nan, back(centre + side * reach)) for side in (-1, 1))
    return low, high


def difference(own: Replicates, reference: Replicates, level: float = LEVEL) -> IntervalEstimate:
    """The value less the reference's, paired: both are of the same units.

    The jackknife over units of the difference itself, with Student's t as in `interval`. Two trackers with the same
    sums differ by 0 with p = 1. The interval and p are NaN with fewer than LEAST_UNITS, and where fewer than
    LEAST_AGREEING effective units agree. Raises ValueError for other numbers of units.
    """
    value = own.value - reference.value
    if own.units != reference.units:
        raise ValueError(f"{own.units} units cannot be paired with {reference.units}")
    if own.units < LEAST_UNITS:
        return IntervalEstimate.unknown(value)
    error = _standard_error(np.nan_to_num(own.without - reference.without))
    return difference_of(value, error, degrees_of_freedom(own.size, reference.size), level)


def difference_of(value: Floats, error: Floats, freedom: Floats, level: float = LEVEL) -> IntervalEstimate:
    """Interval and p-value of the difference `value` (...) by its standard error and the degrees of freedom of this.

    A difference up to WITHIN_ROUNDING is none; above it, with an error below, it needs LEAST_AGREEING effective units.
    """
    reach = _quantile(freedom, level) * error
    none = np.abs(value) <= WITHIN_ROUNDING
    with np.errstate(divide="ignore", invalid="ignore"):
        p = np.where(none, 1.0, 2 * scipy.special.stdtr(freedom, -np.abs(value) / error))
    unknown = np.isnan(value) | (~none & (error <= WITHIN_ROUNDING) & (freedom < LEAST_AGREEING - 1))
    return IntervalEstimate(value, *(np.where(unknown, np.nan, x) for x in (value - reach, value + reach, p)))


def verdict_of(difference: float, p: float) -> str:
    """The verdict of a difference, above 0 where the tracker is better, with its corrected p-value."""
    if np.isnan(p):
        return "not tested"
    if p >= ALPHA:
        return "no difference shown"
    return "better" if difference > 0 else "worse"


def holm(p: NDArray[np.floating]) -> Floats:
    """Holm's step-down correction (N,) of a family of p-values (N,), which bounds the family-wise error rate.

    Holm, Scandinavian Journal of Statistics 6 (1979). NaN is a comparison without a result: it stays NaN and is not
    part of the family.
    """
    p = np.asarray(p, np.float64)
    adjusted = np.full_like(p, np.nan)
    made = np.flatnonzero(~np.isnan(p))
    order = made[np.argsort(p[made], kind="stable")]
    scaled = p[order] * np.arange(len(order), 0, -1)
    adjusted[order] = np.minimum(np.maximum.accumulate(scaled), 1.0)
    return adjusted


def degrees_of_freedom(*sizes: Floats) -> Floats:
    """Degrees of freedom (...) of a jackknife over units: their effective number less one, and at least 1.

    The effective number is the number of equal units with the same information (Kish 1965). Of several `sizes` (U, ...)
    of the units the smallest number counts, without values that are 0 in all units.
    """
    effective = np.fmin.reduce([divided(one.sum(axis=0) ** 2, (one**2).sum(axis=0)) for one in sizes])
    freedom: Floats = np.fmax(effective - 1, 1.0)
    return freedom


def _without_each(sums: Floats) -> Floats:
    """Total (U, ...) without each unit in turn."""
    without: Floats = np.maximum(sums.sum(axis=0) - sums, 0.0)
    return without


def _log_without_each(sums: Floats, *, counted: bool) -> Floats:
    """The logarithm (U, ...) of the total without each unit in turn; `counted`: with half a count more."""
    without = _without_each(sums)
    least = np.maximum(_SMALLEST_SHARE * sums.sum(axis=0), np.finfo(np.float64).tiny)
    log: Floats = np.log(without + HALF_A_COUNT if counted else np.maximum(without, least))
    return log


def _standard_error(without: Floats) -> Floats:
    """Jackknife standard error (...) of the estimates `without` (U, ...), each without one unit."""
    units = len(without)
    deviation = without - without.mean(axis=0)
    error: Floats = np.sqrt((units - 1) / units * (deviation**2).sum(axis=0))
    return error


def _quantile(freedom: Floats, level: float) -> Floats:
    """Two-sided quantile of Student's t."""
    quantile: Floats = scipy.special.stdtrit(freedom, 0.5 + level / 2)
    return quantile
