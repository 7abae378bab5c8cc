"""Trackers with several trainings as a table: mean F1, spread between trainings, and differences judged with it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import fmean, stdev

from gridtrack.evaluation.runs.summary import TrackerTrainings, TrainingsScore
from gridtrack.evaluation.statistics.score_intervals import HEADLINE_STRATA
from gridtrack.reports.differences import interval_text, p_text
from gridtrack.reports.run import UNDEFINED, ReportedRun
from gridtrack.reports.table import HeadlineTable, TableRow, name_in, name_of


@dataclass(frozen=True)
class TrainingsCell:
    """One stratum and horizon, as text; empty where there is nothing."""

    mean: str
    spread: str
    difference: str
    p: str
    verdict: str


@dataclass(frozen=True)
class TrainingsRow:
    """One tracker; `count` trainings, the rows of the page with these `keys`. `reason`: why its difference has no
    interval."""

    name: str
    keys: tuple[str, ...]
    count: int
    cells: tuple[TrainingsCell, ...]
    reason: str


@dataclass(frozen=True)
class TrainingsTable:
    """Every tracker by its trainings, on one recording or pooled over all."""

    reference: str
    """What the trackers are compared with; empty for the trainings of several runs, which are not compared."""
    columns: tuple[tuple[str, float], ...]
    """Stratum and horizon, seconds."""
    units: int
    """Of the comparison."""
    rows: tuple[TrainingsRow, ...]


def trainings_table(run: ReportedRun, recording: str) -> TrainingsTable | None:
    """The table of one recording of a run; None where no tracker has several trainings."""
    found = [one for one in run.summary.trainings if one.recordings == recording]
    if not found:
        return None
    columns = tuple((score.stratum, score.horizon_s) for score in found[0].scores)
    reference = name_in(run, found[0].reference, recording)
    return TrainingsTable(reference, columns, found[0].units, tuple(_row(run, one) for one in found))


def _row(run: ReportedRun, one: TrackerTrainings) -> TrainingsRow:
    name = name_in(run, one.labels[0], one.recordings)
    return TrainingsRow(name, one.labels, len(one.labels), tuple(map(_cell, one.scores)), one.interval)


def _cell(score: TrainingsScore) -> TrainingsCell:
    difference = "" if score.difference is None else f"{score.difference:+.3f}"
    interval = interval_text(score.difference_low, score.difference_high, 3)
    return TrainingsCell(
        mean=UNDEFINED if score.f1_mean is None else f"{score.f1_mean:.3f}",
        spread="" if score.f1_spread is None else f"± {score.f1_spread:.3f}",
        difference=f"{difference} {interval}".strip(),
        p=p_text(score.p_holm),
        verdict=score.verdict if score.p_holm is not None else "",
    )


def trainings_across(runs: Sequence[ReportedRun], table: HeadlineTable) -> TrainingsTable | None:
    """The rows of several runs that differ in their weights alone; None where there are no two, or other frames."""
    by_run = {run.name: run for run in runs}
    trainings: dict[str, dict[str, TableRow]] = {}
    for row in table.rows if table.comparable else ():
        weights = _weights_of(by_run[row.run], row.label)
        if weights and row.trial.ranked:
            same = json.dumps([row.entry.tracker, row.entry.points, row.entry.options], sort_keys=True)
            trainings.setdefault(same, {}).setdefault(weights, row)
    columns = [i for i, one in enumerate(table.columns) if one.score == "f1" and one.stratum in HEADLINE_STRATA]
    rows = tuple(
        TrainingsRow(
            _name_of(tuple(found.values())),
            tuple(row.key for row in found.values()),
            len(found),
            tuple(_spread_cell([row.cells[i].value for row in found.values()]) for i in columns),
            "",
        )
        for found in trainings.values()
        if len(found) > 1
    )
    named = tuple((table.columns[i].stratum, table.horizons_s[table.columns[i].step]) for i in columns)
    return TrainingsTable("", named, 0, rows) if rows else None


def _name_of(rows: Sequence[TableRow]) -> str:
    """The label that all rows have, else the name of their tracker."""
    labels = {row.label for row in rows}
    return name_of(rows[0].label, rows[0].trial) if len(labels) == 1 else rows[0].entry.tracker


def _weights_of(run: ReportedRun, label: str) -> str:
    """The hashes of the weights of a row on all recordings; empty where it has none."""
    used = run.record.weights
    return " ".join(used[name].sha256 for one in run.recordings if (name := f"{label}@{one}") in used)


def _spread_cell(values: Sequence[float | None]) -> TrainingsCell:
    defined = [value for value in values if value is not None]
    if len(defined) < len(values):
        return TrainingsCell(UNDEFINED, "", "", "", "")
    ends = f"{min(defined):.3f} to {max(defined):.3f}"
    return TrainingsCell(f"{fmean(defined):.3f}", f"± {stdev(defined):.3f}", ends, "", "")
