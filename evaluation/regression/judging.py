"""Judging one row: over all units, and on single recordings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.regression.criteria import COLLAPSE, COLLAPSE_ERRORS, LARGE_MARGINS, RowTest
from gridtrack.evaluation.regression.noise import UnitFalls, standard_error, unit_falls
from gridtrack.evaluation.regression.rows import LARGEST, SHARE_PER_F1, JudgedScore, PairedRow
from gridtrack.evaluation.regression.settings import MARGIN, GateSettings
from gridtrack.evaluation.regression.significance import FAMILY_LEVEL
from gridtrack.evaluation.statistics.training_spread import value_of

RowVerdict = Literal["worse", "no worse", "equal", "nothing to find"]
Criterion = Literal["", "margin", "significant", "large", "collapse"]
"""Why a row is worse: beyond the margin (few units), beyond it and significant, large, or on a single recording."""
ROUNDING: dict[JudgedScore, float] = {"F1": 1e-9, "log loss": 1e-4, "class log loss": 1e-4}
"""A smaller fall in F1, or share of a log loss, is rounding."""


@dataclass(frozen=True, slots=True)
class VerdictRow:
    """One tracker, score, stratum and step band over all units, or over those of `recording` where it is not empty.

    Of class log loss `stratum` is the visibility of the cells. `baseline` and `run` are the score pooled over steps and
    frames, log losses in nats, None where it is undefined; of several runs of the baseline, that of the mean counts.
    `fall`, `margin` and `smallest` are of F1, of a log loss shares of its baseline. `p`: the p-value of the fall,
    corrected for the family; None with too few units, and for a single recording. `spread`: the standard deviation of
    the score between trainings; None where it is not known. `smallest`: the smallest fall that would have been found;
    infinite where the score cannot fall by as much.
    """

    label: str
    score: JudgedScore
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

    @property
    def severity(self) -> float:
        """The fall as one in F1: a share of a log loss counts less by SHARE_PER_F1."""
        return self.fall if self.score == "F1" else self.fall / SHARE_PER_F1


def judged_row(row: PairedRow, test: RowTest, settings: GateSettings) -> VerdictRow:
    """The row over all units, with its verdict."""
    f1_margin = settings.margin_of(row.label, test.p is not None)
    margin, limit = row.margin_of(f1_margin), row.margin_of(LARGE_MARGINS * max(f1_margin, MARGIN))
    over_all = _over(row, np.ones(len(row.units), bool), "", margin)
    unit, beyond = _unit(row, over_all), over_all.fall > margin + ROUNDING[row.score]
    smallest = _possible(row, over_all, _smallest(test, margin, limit, unit))
    if over_all.verdict != "no worse":
        return replace(over_all, p=test.p, spread=test.spread, smallest=smallest)
    criterion: Criterion = ""
    if beyond and test.p is None:
        criterion = "margin"
    elif beyond and test.p is not None and test.p <= FAMILY_LEVEL:
        criterion = "significant"
    elif test.p is not None and test.is_large(over_all.fall * unit, limit * unit):
        criterion = "large"
    return replace(
        over_all,
        p=test.p,
        spread=test.spread,
        smallest=smallest,
        criterion=criterion,
        verdict="worse" if criterion else "no worse",
    )


def judged_recordings(
    rows: Sequence[PairedRow], tests: Sequence[RowTest], settings: GateSettings
) -> tuple[VerdictRow, ...]:
    """The worst fall of each tracker on each recording: a collapse, which is worse, else one beyond the margin, which
    is only listed. The largest first.

    A single recording is what the row over all units judges, where a collapse is large or, with few units, beyond the
    margin, and where it must be beyond the spread between trainings: nothing is added.
    """
    worst: dict[tuple[str, str], VerdictRow] = {}
    for row, test in zip(rows, tests, strict=True):
        if len(set(row.recordings)) == 1:
            continue
        for found in _on_recordings(row, settings.margin_of(row.label, test.p is not None)):
            known = worst.get((found.label, found.recording))
            rank = (found.verdict == "worse", found.severity)
            if known is None or rank > (known.verdict == "worse", known.severity):
                worst[found.label, found.recording] = found
    return tuple(sorted(worst.values(), key=lambda row: (row.verdict != "worse", -row.severity)))


def judged_on(row: PairedRow, recording: str, f1_margin: float, falls: UnitFalls) -> VerdictRow:
    """The row on one recording, where a collapse is worse; `f1_margin` is the tracker's margin of F1, `falls` are those
    of the row."""
    margin, limit = (row.margin_of(m) for m in (max(f1_margin, MARGIN), max(COLLAPSE, LARGE_MARGINS * f1_margin)))
    members = np.array(row.recordings) == recording
    found = _over(row, members, recording, margin)
    if found.verdict != "no worse":
        return found
    needed = COLLAPSE_ERRORS * standard_error(row, members, falls) / _unit(row, found)
    collapsed = found.fall > max(limit, needed)
    return replace(
        found,
        smallest=_possible(row, found, max(limit, needed)),
        criterion="collapse" if collapsed else "",
        verdict="worse" if collapsed else "no worse",
    )


def _on_recordings(row: PairedRow, f1_margin: float) -> Iterator[VerdictRow]:
    """The falls of a row beyond the margin on single recordings."""
    if row.equal:
        return
    falls = unit_falls(row)
    for name in dict.fromkeys(row.recordings):
        found = judged_on(row, name, f1_margin, falls)
        if found.verdict != "nothing to find" and found.fall > found.margin:
            yield found


def _over(row: PairedRow, members: NDArray[np.bool_], recording: str, margin: float) -> VerdictRow:
    """The row over the parts `members` (P,), not judged."""
    then, now = (
        None if np.isnan(value) else float(value)
        for value in (value_of(side[members].sum(axis=0)) for side in (row.baseline, row.run))
    )
    verdict: RowVerdict = "equal" if row.equal else "no worse"
    fall = 0.0
    if then is None or now is None or not row.occurs[members].any():
        then = now = None
        verdict = "nothing to find"
    elif then or row.score == "F1":
        fall = row.in_margin_units(row.sign * (then - now), then)
    return VerdictRow(
        row.label, row.score, row.region, row.band, recording, then, now, fall, margin, margin, None, None, "", verdict
    )  # fmt: skip


def _unit(row: PairedRow, found: VerdictRow) -> float:
    """What a fall, as margins are given, is multiplied by to be one in the score."""
    return 1.0 if row.score == "F1" else found.baseline or 1.0


def _smallest(test: RowTest, margin: float, limit: float, unit: float) -> float:
    return margin if test.p is None else test.smallest(margin * unit, limit * unit) / unit


def _possible(row: PairedRow, found: VerdictRow, smallest: float) -> float:
    """`smallest`, as margins are given; infinite where the score cannot change by more than that."""
    then = found.baseline
    if then is None or (row.score != "F1" and not then):
        return smallest
    largest = then if row.score == "F1" else (LARGEST[row.score] - then) / then
    return smallest if smallest < largest else float("inf")
