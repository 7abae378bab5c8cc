"""Scores on occluded cells at three thresholds, and their differences from the reference."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gridtrack.evaluation.referee.strata import OCCLUDED
from gridtrack.evaluation.runs.summary import OccludedDifference
from gridtrack.reports.differences import p_text
from gridtrack.reports.run import ReportedRun
from gridtrack.reports.table import HeadlineTable, TableRow, name_in

SCORE_HEADINGS = {
    "f1": "F1 at a threshold chosen with the truth",
    "f1_at_visible": "F1 at that of visible cells",
    "f1_at_half": "F1 at 0.5",
    "nll": "log loss",
}
"""The scores by their names in summary.json."""


@dataclass(frozen=True)
class OccludedScore:
    """One score, and its difference from the reference with interval and p-value; empty texts where there is none."""

    value: float | None
    difference: str = ""
    interval: str = ""
    p: str = ""


@dataclass(frozen=True)
class OccludedThresholds:
    """The scores of every tracker on occluded cells, in the order of SCORE_HEADINGS."""

    horizon: str
    reference: str
    headings: tuple[str, ...]
    rows: tuple[tuple[TableRow, tuple[OccludedScore, ...]], ...]
    turned: bool
    """Whether the ranked rows are in another order at another threshold."""


def occluded_thresholds(table: HeadlineTable, run: ReportedRun | None) -> OccludedThresholds | None:
    """The table of a recording with ground truth; None for one without. `run`: the only run on the page, if it is."""
    step = table.decisive.step
    found = {} if run is None else _differences(run, table.recording)
    rows = tuple(
        (row, tuple(_score(row, name, found.get(row.label), step) for name in SCORE_HEADINGS))
        for row in table.rows
        if OCCLUDED in row.trial.strata
    )
    if not rows:
        return None
    reference = next((name_in(run, one.reference, table.recording) for one in found.values() if run), "")
    return OccludedThresholds(table.decisive.heading, reference, tuple(SCORE_HEADINGS.values()), rows, _turned(rows))


def _differences(run: ReportedRun, recording: str) -> Mapping[str, OccludedDifference]:
    return {one.tracker: one for one in run.summary.occluded_differences if one.recordings == recording}


def _score(row: TableRow, name: str, difference: OccludedDifference | None, step: int) -> OccludedScore:
    value = row.trial.strata[OCCLUDED].at(name, step)
    if difference is None or name not in difference.scores:
        return OccludedScore(value)
    found = difference.scores[name]
    less, low, high = found.value[step], found.low[step], found.high[step]
    return OccludedScore(
        value,
        "" if less is None else f"{less:+.3f}",
        "" if low is None or high is None else f"[{low:+.3f}, {high:+.3f}]",
        p_text(found.p[step]),
    )


def _turned(rows: tuple[tuple[TableRow, tuple[OccludedScore, ...]], ...]) -> bool:
    """Whether two ranked rows change places between two of the thresholds."""
    ranked = [[score.value for score in scores[:3]] for row, scores in rows if row.group == "ranked"]
    defined = [[value for value in values if value is not None] for values in ranked]
    by_threshold = np.array([values for values in defined if len(values) == 3]).reshape(-1, 3).T
    orders = [np.argsort(-f1, kind="stable").tolist() for f1 in by_threshold]
    return any(order != orders[0] for order in orders)
