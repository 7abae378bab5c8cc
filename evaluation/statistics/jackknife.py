"""Intervals of pooled scores, and paired differences of two trackers, from the counts of statistical units.

A unit is a whole recording, or a block of time longer than the autocorrelation of the frames (`units`). How the
method was chosen, and its coverage: docs/statistics.md, `studies/coverage.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit, stdtr, stdtrit

from gridtrack.evaluation.results.columns import CONFUSION

Floats = NDArray[np.float64]

COUNTS = (*CONFUSION, "squared_error", "log_loss")
"""The columns C of counts (..., C): cells at the threshold in use, and sums over cells."""
_CELLS = dict.fromkeys(CONFUSION, 1)
RATIO_SCORES: dict[str, tuple[dict[str, int], dict[str, int]]] = {
    "f1": ({"tp": 2}, {"tp": 2, "fp": 1, "fn": 1}),
    "precision": ({"tp": 1}, {"tp": 1, "fp": 1}),
    "recall": ({"tp": 1}, {"tp": 1, "fn": 1}),
    "brier": ({"squared_error": 1}, _CELLS),
    "nll": ({"log_loss": 1}, _CELLS),
}
"""The scores that are ratios of sums over cells: weights of the counts in the numerator and in the denominator."""
PROPORTIONS = ("f1", "precision", "recall", "brier")
"""The scores whose numerator is a part of their denominator."""
LEVEL = 0.95
LEAST_UNITS = 20
"""With fewer units no interval is computed: no method that was tried reaches its nominal coverage there."""
LEAST_AGREEING = 6
"""Units that agree exactly have no spread to go by: six equal ones are the fewest by which a sign test tells any."""
TOO_SHORT = "too short for an interval"
HALF_A_COUNT = 0.5
"""Added to counts of cells before the logarithm. A sum of losses is no count: half a nat may be most of it."""
_COUNTED = ("f1", "precision", "recall")
"""The scores of which both sums of the odds are counts."""
WITHIN_ROUNDING = 1e-9
"""Differences that are no larger are none."""
_NEAREST_TO_0_OR_1 = 1e-9
"""Scores without a unit are no nearer to 0 and 1, where log odds are infinite; a sum that is no count is no smaller
share of that over all units."""


@dataclass(frozen=True, slots=True)
class PairedDifferences:
    """Score of a tracker less score of its reference (...), interval [low, high], p-value of no difference."""

    value: Floats
    low: Floats
    high: Floats
    p: Floats

    def column(self, k: int) -> PairedDifferences:
        """The differences of one index of the last axis."""
        return PairedDifferences(self.value[..., k], self.low[..., k], self.high[..., k], self.p[..., k])

    def at(self, index: int) -> PairedDifferences:
        """The differences at one index of the first axis."""
        return PairedDifferences(self.value[index], self.low[index], self.high[index], self.p[index])


def pooled(counts: NDArray[np.floating], score: str) -> Floats:
    """The score (...) of all units together, of `counts` (U, ..., C): a ratio of sums; NaN where it is undefined."""
    part, whole = ratio_sums(counts, score)
    return _ratio(part.sum(axis=0), whole.sum(axis=0))


def ratio_sums(counts: NDArray[np.floating], score: str) -> tuple[Floats, Floats]:
    """Numerator and denominator (U, ...) of a score in RATIO_SCORES of `counts` (U, ..., C) of units.

    F1 is undefined where no cell was occupied in any unit, as in `metrics.f1_score`: its denominators are 0 there.
    """
    weights = (np.array([side.get(name, 0) for name in COUNTS], np.float64) for side in RATIO_SCORES[score])
    part, whole = (np.asarray(counts, np.float64) @ weight for weight in weights)
    if score == "f1":
        positives = counts[..., COUNTS.index("tp")] + counts[..., COUNTS.index("fn")]
        whole *= positives.sum(axis=0) > 0
    return part, whole


def interval(counts: NDArray[np.floating], score: str = "f1", level: float = LEVEL) -> tuple[Floats, Floats]:
    """Confidence interval (low, high), each (...), of a pooled score from `counts` (U, ..., C) of units; NaN where
    there are fewer than LEAST_UNITS, or the score is undefined.

    The jackknife over units of the logarithm of the odds (of the ratio, for `nll`), with Student's t: its degrees of
    freedom are the effective number of units less one (Kish 1965), the smaller of those of the two sums in the odds.
    Half a count is added to each sum where both are counts. Where the score is 0 in all units, or 1 in all, the
    interval is that point; NaN where these are fewer than LEAST_AGREEING effective units.
    """
    part, whole = ratio_sums(counts, score)
    if score in PROPORTIONS:
        return proportion_interval(part, whole, level, counted=score in _COUNTED)
    return ratio_interval(part, whole, level)


def ratio_interval(part: Floats, whole: Floats, level: float = LEVEL) -> tuple[Floats, Floats]:
    """`interval` of the ratio of two sums over units (U, ...), neither a part of the other; the first is no count."""
    return _interval(part, whole, whole, np.exp, level, counted=False)


def proportion_interval(
    part: Floats, whole: Floats, level: float = LEVEL, *, counted: bool = True
) -> tuple[Floats, Floats]:
    """`interval` of the ratio of two sums over units (U, ...), the first a part of the second; `counted`: of counts."""
    return _interval(part, whole - part, whole, expit, level, counted=counted)


def _interval(
    part: Floats, other: Floats, whole: Floats, back: Callable[[Floats], Floats], level: float, *, counted: bool
) -> tuple[Floats, Floats]:
    """Interval of the score `part` / `whole` (...); `back` maps the logarithm of the odds `part` / `other` (U, ...) to
    it. `counted`: both sums of the odds are counts.
    """
    value = _ratio(part.sum(axis=0), whole.sum(axis=0))
    if len(part) < LEAST_UNITS:
        return np.full_like(value, np.nan), np.full_like(value, np.nan)
    of_part, of_other = (_log_without_each(sums, counted=counted) for sums in (part, other))
    error = _standard_error(of_part - of_other)
    freedom = degrees_of_freedom(part, other)
    reach = _quantile(freedom, level) * error
    with np.errstate(divide="ignore", invalid="ignore"):
        centre = np.log(part.sum(axis=0)) - np.log(other.sum(axis=0))
    low, high = (back(centre + side * reach) for side in (-1, 1))
    agreed = (part.sum(axis=0) == 0) | (other.sum(axis=0) == 0)
    unknown = np.isnan(value) | (agreed & (freedom < LEAST_AGREEING - 1))
    low, high = (np.where(unknown, np.nan, np.where(agreed, value, end)) for end in (low, high))
    return low, high


def differences(
    counts: NDArray[np.floating], reference: NDArray[np.floating], score: str = "f1", level: float = LEVEL
) -> PairedDifferences:
    """Pooled score less the reference's, paired: `counts` and `reference` (U, ..., C) are of the same units.

    The jackknife over units of the difference itself, with Student's t as in `interval`; the effective number of units
    is that of the denominators. Two trackers with the same counts differ by 0 with p = 1. The interval and p are NaN
    with fewer than LEAST_UNITS, and where fewer than LEAST_AGREEING effective units agree.
    """
    value = pooled(counts, score) - pooled(reference, score)
    return _differences(ratio_sums(counts, score), ratio_sums(reference, score), value, level)


def ratio_differences(
    own: tuple[Floats, Floats], reference: tuple[Floats, Floats], level: float = LEVEL
) -> PairedDifferences:
    """`differences` of the ratios of two sums, each side's part and whole (U, ...) by the same units."""
    ratios = [_ratio(part.sum(axis=0), whole.sum(axis=0)) for part, whole in (own, reference)]
    return _differences(own, reference, ratios[0] - ratios[1], level)


def _differences(
    own: tuple[Floats, Floats], reference: tuple[Floats, Floats], value: Floats, level: float
) -> PairedDifferences:
    units, others = len(own[0]), len(reference[0])
    if units != others:
        raise ValueError(f"{units} units cannot be paired with {others}")
    if units < LEAST_UNITS:
        nothing = np.full_like(value, np.nan)
        return PairedDifferences(value, nothing, nothing.copy(), nothing.copy())
    without = [_ratio(_without_each(part), _without_each(whole)) for part, whole in (own, reference)]
    error = _standard_error(np.nan_to_num(without[0] - without[1]))
    return difference_of(value, error, degrees_of_freedom(own[1], reference[1]), level)


def difference_of(value: Floats, error: Floats, freedom: Floats, level: float = LEVEL) -> PairedDifferences:
    """Interval and p-value of the difference `value` (...) by its standard error and the degrees of freedom of this.

    Up to WITHIN_ROUNDING it is none; above it, with an error below, LEAST_AGREEING effective units are needed.
    """
    reach = _quantile(freedom, level) * error
    none = np.abs(value) <= WITHIN_ROUNDING
    with np.errstate(divide="ignore", invalid="ignore"):
        p = np.where(none, 1.0, 2 * stdtr(freedom, -np.abs(value) / error))
    unknown = np.isnan(value) | (~none & (error <= WITHIN_ROUNDING) & (freedom < LEAST_AGREEING - 1))
    return PairedDifferences(value, *(np.where(unknown, np.nan, x) for x in (value - reach, value + reach, p)))


@dataclass(frozen=True, slots=True)
class JackknifedScore:
    """A score (...) that is no ratio of sums, such as PR-AUC or a median, and its values (U, ...) without each unit.

    `sizes` (U, ...): how much each unit counts, for the effective number of units.
    """

    value: Floats
    without: Floats
    sizes: Floats

    @property
    def rests_on_one_unit(self) -> NDArray[np.bool_]:
        """Whether the score (...) is undefined without one of the units, which then gives no interval."""
        rests: NDArray[np.bool_] = ~np.isnan(self.value) & np.isnan(self.without).any(axis=0)
        return rests

    def interval(self, level: float = LEVEL) -> tuple[Floats, Floats]:
        """`interval` of a score in [0, 1]: the jackknife of its log odds. NaN with fewer than LEAST_UNITS, and where
        it rests on one unit.
        """
        inside = np.clip(self.without, _NEAREST_TO_0_OR_1, 1 - _NEAREST_TO_0_OR_1)
        return self._interval_of(logit, inside, expit, level)

    def positive_interval(self, level: float = LEVEL) -> tuple[Floats, Floats]:
        """`interval` of a score above 0, such as a median error: the jackknife of its logarithm."""
        return self._interval_of(np.log, self.without, np.exp, level)

    def _interval_of(
        self, forth: Callable[[Floats], Floats], without: Floats, back: Callable[[Floats], Floats], level: float
    ) -> tuple[Floats, Floats]:
        """Interval by the jackknife of `forth` of the score, which `back` inverts."""
        if len(without) < LEAST_UNITS:
            return np.full_like(self.value, np.nan), np.full_like(self.value, np.nan)
        reach = _quantile(degrees_of_freedom(self.sizes), level) * _standard_error(forth(without))
        with np.errstate(divide="ignore"):
            centre = forth(self.value)
        low, high = (np.where(np.isnan(self.value), np.nan, back(centre + side * reach)) for side in (-1, 1))
        return low, high

    def minus(self, other: JackknifedScore) -> JackknifedScore:
        """This score less another one of the same units, itself a score to compare."""
        sizes = np.minimum(self.sizes, other.sizes)
        return JackknifedScore(self.value - other.value, self.without - other.without, sizes)

    def less(self, reference: JackknifedScore, level: float = LEVEL) -> PairedDifferences:
        """`differences` of this score and the reference's, of the same units."""
        value = self.value - reference.value
        if len(self.without) < LEAST_UNITS:
            nothing = np.full_like(value, np.nan)
            return PairedDifferences(value, nothing, nothing.copy(), nothing.copy())
        error = _standard_error(np.nan_to_num(self.without - reference.without))
        return difference_of(value, error, degrees_of_freedom(self.sizes, reference.sizes), level)


def jackknifed(counts: NDArray[np.floating], score: str = "f1") -> JackknifedScore:
    """The pooled score of `counts` (U, ..., C), and its values without each of the units."""
    part, whole = ratio_sums(counts, score)
    return JackknifedScore(pooled(counts, score), _ratio(_without_each(part), _without_each(whole)), whole)


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

    The effective number is that of equal units with the same information (Kish 1965); of several `sizes` (U, ...) of
    the units the smallest, without those that are 0 in all units.
    """
    effective = np.fmin.reduce([_ratio(one.sum(axis=0) ** 2, (one**2).sum(axis=0)) for one in sizes])
    freedom: Floats = np.fmax(effective - 1, 1.0)
    return freedom


def _ratio(part: Floats, whole: Floats) -> Floats:
    ratio = np.full(whole.shape, np.nan)
    np.divide(part, whole, out=ratio, where=whole > 0)
    return ratio


def _without_each(sums: Floats) -> Floats:
    """Total (U, ...) without each unit in turn."""
    without: Floats = np.maximum(sums.sum(axis=0) - sums, 0.0)
    return without


def _log_without_each(sums: Floats, *, counted: bool) -> Floats:
    """The logarithm (U, ...) of the total without each unit in turn; `counted`: with half a count more."""
    without = _without_each(sums)
    least = np.maximum(_NEAREST_TO_0_OR_1 * sums.sum(axis=0), np.finfo(np.float64).tiny)
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
    quantile: Floats = stdtrit(freedom, 0.5 + level / 2)
    return quantile
