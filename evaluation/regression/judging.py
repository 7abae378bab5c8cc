"""Judging one row. Over all units a fall is worse if it is significant and beyond the margin; on a single recording if
it is a collapse.

A paired test over units finds a fall in few units late, because such a fall raises the variance too. A collapse is
therefore compared with the variation of the *typical* unit. Let f_u be the fall of unit u, and w_u its share of the
cells. The typical fall is the weighted median of f_u. The scale of the deviations from it is the QUANTILE of their
absolute values, divided by the same quantile of a normal distribution, so that up to five of twenty units may collapse
without an effect on it (Huber, Robust Statistics, 1981, chapter 5). The scale is estimated twice: equal for all units,
and proportional to 1 / sqrt(w_u). The standard error of a set of units is the larger one, and at least the error of
its cells. One cell in CELLS_TOGETHER counts there: the cells of an object are found or missed together, in several
steps.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from gridtrack.evaluation.regression.rows import PairedRow, RowTest
from gridtrack.evaluation.regression.settings import MARGIN, GateSettings
from gridtrack.evaluation.scores.cells import CLIP
from gridtrack.evaluation.scores.definition import Floats
from gridtrack.evaluation.statistics.jackknife import ALPHA, LEAST_UNITS

RowVerdict = Literal["worse", "no worse", "equal", "nothing to find"]
Criterion = Literal["", "margin", "significant", "collapse", "best"]
"""Why a row is worse: beyond the margin (few units), beyond it and significant, on a single recording, or below the
best entry of the history."""
COLLAPSE = 20.0
"""A fall on one recording of more than this many margins is a collapse: 0.1 of F1, a log loss twice as large."""
COLLAPSE_ERRORS = 6.0
"""A collapse must exceed so many standard errors of the typical unit: a run has hundreds of rows times recordings."""
QUANTILE = 0.7
"""Quantile of the absolute deviations. With the median, units without a change could make the scale 0."""
QUANTILE_OF_NORMAL = float(ndtri(0.5 + QUANTILE / 2))
CELLS_TOGETHER = 25.0
"""Ten cells or more of an object, over the four to eight steps of a band."""
ROUNDING, RELATIVE_ROUNDING = 1e-9, 1e-4
"""Smaller falls count as zero. RELATIVE_ROUNDING is for shares of a log loss: its sums are stored to six digits."""


@dataclass(frozen=True, slots=True)
class VerdictRow:
    """One tracker, score, stratum and step band over all units, or over the units of `recording` if it is not empty.

    `score` is SCORE.OUTPUT, `title` its name. `baseline` and `run`: the score pooled over steps and frames; None if it
    is undefined. Several runs of the baseline count by their mean sums. `fall`, `margin` and `smallest` are in the unit
    of margins: with `relative`, shares of the baseline's value. `p`: the p-value of the fall, corrected over all rows;
    None with too few units, and for a single recording. `spread`: the standard deviation of the score between
    trainings; None if unknown. `smallest`: the smallest fall that would have been found; infinite if the score cannot
    fall that far.
    """

    label: str
    score: str
    title: str
    stratum: str
    band: str
    recording: str
    baseline: float | None
    run: float | None
    fall: float
    margin: float
    smallest: float
    p: float | None
    spread: float | None
    criterion: Criterion
    verdict: RowVerdict
    relative: bool = False
    higher_is_better: bool = True
    default_margin: float = MARGIN
    since: str = ""
    """The entry of a history with the value `baseline`; empty if the value is the baseline's."""

    @property
    def name(self) -> str:
        """The title of the score in a sentence: `F1`, `log loss`."""
        lower = len(self.title) > 1 and self.title[1].islower()
        return self.title[:1].lower() + self.title[1:] if lower else self.title

    @property
    def severity(self) -> float:
        """The fall in margins, by which rows of different scores are ordered."""
        return self.fall / self.default_margin


def judged_row(row: PairedRow, test: RowTest, settings: GateSettings) -> VerdictRow:
    """The row over all units, with its verdict."""
    margin = _margin(row, settings, enough_units=test.p is not None)
    over_all = _over(row, np.ones(len(row.units), bool), "", margin)
    unit, beyond = _unit(row, over_all), over_all.fall > margin + _rounding(row)
    smallest = _possible(row, over_all, max(margin, test.critical / unit) if test.p is not None else margin)
    known = replace(over_all, p=test.p, spread=test.spread, smallest=smallest)
    if over_all.verdict != "no worse" or not beyond:
        return known
    if test.p is None:
        return replace(known, criterion="margin", verdict="worse")
    return replace(known, criterion="significant", verdict="worse") if test.p <= ALPHA else known


def judged_recordings(
    rows: Sequence[PairedRow], tests: Sequence[RowTest], settings: GateSettings
) -> tuple[VerdictRow, ...]:
    """The worst fall of each tracker on each recording, the largest first: a collapse, which is worse, or else a fall
    beyond the margin, which is only listed. A run of one recording has none: its rows over all units decide."""
    worst: dict[tuple[str, str], VerdictRow] = {}
    for row, test in zip(rows, tests, strict=True):
        if len(set(row.recordings)) == 1 or row.equal:
            continue
        margin = max(_margin(row, settings, enough_units=test.p is not None), row.output.margin or 0.0)
        for found in _on_recordings(row, margin):
            known = worst.get((found.label, found.recording))
            rank = (found.verdict == "worse", found.severity)
            if known is None or rank > (known.verdict == "worse", known.severity):
                worst[found.label, found.recording] = found
    return tuple(sorted(worst.values(), key=lambda row: (row.verdict != "worse", -row.severity)))


def _on_recordings(row: PairedRow, margin: float) -> Iterator[VerdictRow]:
    """The falls of a row beyond the margin on single recordings."""
    noise = TypicalUnit.of(row)
    for name in dict.fromkeys(row.recordings):
        found = judged_on(row, name, margin, noise)
        if found.verdict != "nothing to find" and found.fall > found.margin:
            yield found


def judged_on(row: PairedRow, recording: str, margin: float, noise: TypicalUnit) -> VerdictRow:
    """The row on one recording, worse if it is a collapse."""
    members = np.array(row.recordings) == recording
    found = _over(row, members, recording, margin)
    if found.verdict != "no worse":
        return found
    limit = COLLAPSE * max(margin, row.output.margin or 0.0)
    needed = max(limit, COLLAPSE_ERRORS * noise.standard_error(row, members) / _unit(row, found))
    collapsed = found.fall > needed
    return replace(
        found,
        smallest=_possible(row, found, needed),
        criterion="collapse" if collapsed else "",
        verdict="worse" if collapsed else "no worse",
    )


def judged_since(row: VerdictRow, then: float, entry: str) -> VerdictRow:
    """The row over all units, compared with the value `then` of an entry of the history.

    It is worse if it fell by more than the smallest fall that the test against the baseline would have found.
    """
    assert row.run is not None
    fall = (then - row.run) * (1.0 if row.higher_is_better else -1.0)
    fall = fall / then if row.relative and then else fall
    since = replace(row, baseline=then, fall=fall, p=None, spread=None, criterion="", verdict="no worse", since=entry)
    if fall <= row.smallest + (RELATIVE_ROUNDING if row.relative else ROUNDING):
        return since
    return replace(since, criterion="best", verdict="worse")


def _over(row: PairedRow, members: NDArray[np.bool_], recording: str, margin: float) -> VerdictRow:
    """The row over the parts `members` (P,), not judged."""
    then, now = (float(row.value(side[members].sum(axis=0))) for side in (row.baseline, row.run))
    defined = not (np.isnan(then) or np.isnan(now))
    verdict: RowVerdict = "nothing to find" if not defined else "equal" if row.equal else "no worse"
    label, score, stratum, band = row.key
    return VerdictRow(
        label=label,
        score=score,
        title=row.output.title,
        stratum=stratum,
        band=band,
        recording=recording,
        baseline=then if defined else None,
        run=now if defined else None,
        fall=row.fall(then, now) if defined else 0.0,
        margin=margin,
        smallest=margin,
        p=None,
        spread=None,
        criterion="",
        verdict=verdict,
        relative=row.output.relative_margin,
        higher_is_better=row.output.direction > 0,
        default_margin=row.output.margin or MARGIN,
    )


def _margin(row: PairedRow, settings: GateSettings, *, enough_units: bool) -> float:
    """The margin of a row: the score's own, times the user's factor on the margin of F1; 0 with too few units."""
    own = row.output.margin or 0.0
    return own * settings.margin_of(row.label, enough_units) / MARGIN


def _rounding(row: PairedRow) -> float:
    return RELATIVE_ROUNDING if row.output.relative_margin else ROUNDING


def _unit(row: PairedRow, found: VerdictRow) -> float:
    """The factor from the unit of margins to the unit of the score."""
    return found.baseline or 1.0 if row.output.relative_margin else 1.0


def _largest(row: PairedRow) -> float:
    """The largest value of the score: 1, or the loss of a probability that is clipped."""
    return 1.0 if row.output.scale == "odds" else float(-np.log(CLIP))


def _possible(row: PairedRow, found: VerdictRow, smallest: float) -> float:
    """`smallest`, in the unit of margins; infinite if the score cannot change by more than that."""
    then = found.baseline
    if then is None or (row.output.relative_margin and not then):
        return smallest
    room = then if row.output.direction > 0 else _largest(row) - then
    return smallest if smallest < room / _unit(row, found) else float("inf")


@dataclass(frozen=True, slots=True)
class TypicalUnit:
    """The absolute deviations `left` (U,) of the units from the typical fall, and the `weights` (U,) of the units."""

    left: Floats
    weights: Floats

    @classmethod
    def of(cls, row: PairedRow) -> TypicalUnit:
        """From the units of a row in which the score is defined."""
        then, now = row.by_unit(row.baseline), row.by_unit(row.run)
        falls, sizes = row.output.direction * (row.value(then) - row.value(now)), row.size(then)
        known = np.isfinite(falls) & (sizes > 0)
        falls, weights = falls[known], sizes[known] / sizes.sum() if known.any() else sizes[known]
        return cls(np.abs(falls - _weighted_median(falls, weights)) if len(falls) else falls, weights)

    def standard_error(self, row: PairedRow, members: NDArray[np.bool_]) -> float:
        """Standard error of the fall over the parts `members` (P,); with few units, from the cells alone."""
        sizes = row.size(row.baseline)
        share = float(sizes[members].sum() / sizes.sum()) if sizes.sum() else 0.0
        cells = _error_of_cells(row, members)
        if len(self.left) < LEAST_UNITS or not share:
            return cells
        alike = np.quantile(self.left, QUANTILE) / QUANTILE_OF_NORMAL
        by_size = np.quantile(self.left * np.sqrt(self.weights), QUANTILE) / QUANTILE_OF_NORMAL
        effective = max(1.0, share / float((self.weights**2).sum()))
        return float(max(cells, alike / np.sqrt(effective), by_size / np.sqrt(share)))


def _weighted_median(values: Floats, weights: Floats) -> float:
    order = np.argsort(values)
    reached = np.cumsum(weights[order]) >= weights.sum() / 2
    return float(values[order][reached.argmax()])


def _error_of_cells(row: PairedRow, members: NDArray[np.bool_]) -> float:
    """The largest possible standard error of a mean of cells with this value v: by v (max - v) over their number."""
    sums = row.baseline[members].sum(axis=0)
    value, size = float(row.value(sums)), float(row.size(sums))
    if np.isnan(value) or not size:
        return 0.0
    return float(np.sqrt(CELLS_TOGETHER * max(value * (_largest(row) - value), 0.0) / size))
