"""Tests of differences as tables: each tracker against the reference, the trainings of each tracker, and groups of rows
that do not differ significantly."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from statistics import fmean, stdev

from gridtrack.evaluation.runs.finished import HEADLINE_STRATA
from gridtrack.evaluation.runs.summary import (
    HeadlineTest,
    PairFamily,
    PointEstimate,
    TrackerDifference,
    TrackerTrainings,
    TrainingsScore,
)
from gridtrack.reports.markdown import escaped, markdown_table
from gridtrack.reports.run import UNDEFINED, ReportedRun
from gridtrack.reports.table import HeadlineTable, TableRow, name_in

SIGNIFICANT_VERDICTS = ("better", "worse")
"""Verdicts on rows that differ significantly."""


@dataclass(frozen=True)
class DifferenceCell:
    """One difference as text; empty texts if there is none."""

    value: str
    interval: str
    p: str
    verdict: str = ""

    @classmethod
    def of(cls, found: PointEstimate, decimals: int, p: float | None, verdict: str) -> DifferenceCell:
        """A difference with this p-value and verdict."""
        if found.value is None:
            return cls(UNDEFINED, "", "", "not tested")
        return cls(f"{found.value:+.{decimals}f}", interval_text(found, decimals), p_text(p), verdict)


@dataclass(frozen=True)
class DifferenceRow:
    """One tracker and score: the differences in the order of the columns, or the reason why there are none."""

    tracker: str
    name: str
    """The displayed label of the tracker."""
    score: str
    leads: bool
    """Whether it is the row of the headline score."""
    cells: tuple[DifferenceCell, ...]
    reason: str


@dataclass(frozen=True)
class DifferenceTable:
    """All trackers against the reference, on one recording or pooled over all."""

    reference: str
    headline: str
    """The title of the headline score."""
    columns: tuple[tuple[str, float], ...]
    """Stratum and horizon, seconds."""
    units: str
    rows: tuple[DifferenceRow, ...]


def difference_table(run: ReportedRun, recording: str) -> DifferenceTable | None:
    """The table of one recording of a run; None if no tracker could be tested."""
    found = [one for one in run.differences_on(recording) if one.tests or one.interval]
    tested = [one for one in found if one.tests and not one.interval]
    if not tested:
        return None
    columns = tested[0].tests
    compared = {one.tracker: one for one in reversed(found)}
    rows = tuple(
        row for label in dict.fromkeys(one.tracker for one in found) for row in _rows_of(run, compared[label], columns)
    )
    return DifferenceTable(
        name_in(run, tested[0].reference, recording),
        run.summary.find(run.summary.headline)[1].title,
        tuple((test.stratum, test.horizon_s) for test in columns),
        f"{tested[0].units} units, {tested[0].frames} frames",
        rows,
    )


def _rows_of(run: ReportedRun, one: TrackerDifference, columns: Sequence[HeadlineTest]) -> Iterator[DifferenceRow]:
    """The row of the headline score, and if there was a comparison, rows of the run's other tested scores."""
    name = name_in(run, one.tracker, one.recordings)
    score, output = run.summary.find(run.summary.headline)
    if one.interval:
        yield DifferenceRow(one.tracker, name, output.title, True, (), one.interval)
        return
    tests = {(test.stratum, test.horizon_s): test for test in one.tests}
    cells = [
        DifferenceCell.of(
            one.at(at.stratum, score.name, output.name, test.step), output.decimals, test.p_holm, test.verdict
        )
        if (test := tests.get((at.stratum, at.horizon_s)))
        else DifferenceCell(UNDEFINED, "", "", "not tested")
        for at in columns
    ]
    yield DifferenceRow(one.tracker, name, output.title, True, tuple(cells), "")
    for other in (own for own in run.summary.scores if own.name != score.name and own.lead.tested):
        estimates = [one.at(at.stratum, other.name, other.lead.name, at.step) for at in columns]
        if any(found.value is not None for found in estimates):
            uncorrected = (DifferenceCell.of(at, other.lead.decimals, at.p, "uncorrected") for at in estimates)
            yield DifferenceRow(one.tracker, name, other.lead.heading, False, tuple(uncorrected), "")


def interval_text(found: PointEstimate, decimals: int) -> str:
    """The interval of a difference with its signs; empty if there is none."""
    return "" if found.interval is None else "[{0:+.{2}f}, {1:+.{2}f}]".format(*found.interval, decimals)


def p_text(p: float | None) -> str:
    """A p-value with its letter; empty if there is none."""
    if p is None:
        return ""
    return "p < 0.001" if p < 0.001 else f"p = {p:.3f}"


def difference_markdown(differences: DifferenceTable) -> str:
    """The table as Markdown."""
    headings = ["tracker", *(f"{stratum} {horizon_s:g} s" for stratum, horizon_s in differences.columns)]
    empty = [""] * (len(differences.columns) - 1)
    rows = []
    for row in differences.rows:
        cells = [f"{cell.value} {cell.interval} {cell.p} {cell.verdict}" for cell in row.cells]
        rows.append([f"{escaped(row.name)}, {row.score}", *(cells or [escaped(row.reason), *empty])])
    return markdown_table(headings, rows)


def groups_of(family: PairFamily) -> tuple[tuple[str, ...], ...]:
    """Groups of labels: two tested rows differ significantly exactly if no group has both.

    Each group grows from the first pair that no earlier group has. No pair of a group differs significantly, and every
    pair that does not is in a group (Piepho, J. Comp. Graph. Stat. 13, 2004, draws such groups as letters). A row that
    differs from all others is in none.
    """
    labels = list(dict.fromkeys(label for test in family.pairs for label in (test.tracker, test.other)))
    alike = {frozenset((test.tracker, test.other)) for test in family.pairs if test.verdict not in SIGNIFICANT_VERDICTS}
    pairs = ((one, other) for i, one in enumerate(labels) for other in labels[i + 1 :])
    left, groups = [pair for pair in pairs if frozenset(pair) in alike], []
    while left:
        group = list(left[0])
        for label in labels:
            if label not in group and all(frozenset((label, member)) in alike for member in group):
                group.append(label)
        groups.append(tuple(label for label in labels if label in group))
        left = [pair for pair in left if not set(pair) <= set(group)]
    return tuple(groups)


@dataclass(frozen=True)
class TrainingsCell:
    """One stratum and horizon, as text: the mean, the spread between trainings, and below them the difference from the
    reference or, for several runs, the lowest and highest value."""

    mean: str
    spread: str
    below: str = ""
    p: str = ""
    verdict: str = ""


@dataclass(frozen=True)
class TrainingsRow:
    """One tracker. `count` trainings are the rows of the page with these `keys`. `reason`: why its difference has no
    interval."""

    name: str
    keys: tuple[str, ...]
    count: int
    cells: tuple[TrainingsCell, ...]
    reason: str


@dataclass(frozen=True)
class TrainingsTable:
    """The trainings of every tracker, on one recording or pooled over all.

    `title`: the score's. `reference`: the other trackers are compared with it; empty for trainings of several runs,
    which are not compared. `units`: their number in the comparison.
    """

    title: str
    reference: str
    columns: tuple[tuple[str, float], ...]
    """Stratum and horizon, seconds."""
    units: int
    rows: tuple[TrainingsRow, ...]


def trainings_table(run: ReportedRun, recording: str) -> TrainingsTable | None:
    """The table of one recording of a run; None if no tracker has several trainings."""
    found = [one for one in run.summary.trainings if one.recordings == recording]
    if not found:
        return None
    output = run.summary.find(run.summary.headline)[1]
    columns = tuple((score.stratum, score.horizon_s) for score in found[0].scores)
    rows = tuple(_trainings_row(run, one, output.decimals) for one in found)
    return TrainingsTable(output.title, name_in(run, found[0].reference, recording), columns, found[0].units, rows)


def _trainings_row(run: ReportedRun, one: TrackerTrainings, decimals: int) -> TrainingsRow:
    cells = tuple(_trainings_cell(score, decimals) for score in one.scores)
    return TrainingsRow(name_in(run, one.labels[0], one.recordings), one.labels, len(one.labels), cells, one.interval)


def _trainings_cell(score: TrainingsScore, decimals: int) -> TrainingsCell:
    less = score.difference
    value = "" if less.value is None else f"{less.value:+.{decimals}f} {interval_text(less, decimals)}".strip()
    return TrainingsCell(
        mean=UNDEFINED if score.mean is None else f"{score.mean:.{decimals}f}",
        spread="" if score.spread is None else f"± {score.spread:.{decimals}f}",
        below=value,
        p=p_text(score.p_holm),
        verdict=score.verdict if score.p_holm is not None else "",
    )


def trainings_across(runs: Sequence[ReportedRun], table: HeadlineTable) -> TrainingsTable | None:
    """The rows of several runs that differ only in their weights; None without two such rows, or with other frames."""
    by_run = {run.name: run for run in runs}
    trainings: dict[str, dict[str, TableRow]] = {}
    for row in table.rows if table.comparable else ():
        weights = _weights_of(by_run[row.run], row.label)
        if weights and row.trial.ranked:
            same = json.dumps([row.entry.tracker, row.entry.points, row.entry.options], sort_keys=True)
            trainings.setdefault(same, {}).setdefault(weights, row)
    found = [tuple(one.values()) for one in trainings.values() if len(one) > 1]
    at = [i for i, one in enumerate(table.columns) if one.key == table.headline and one.stratum in HEADLINE_STRATA]
    if not found:
        return None
    columns = [table.columns[i] for i in at]
    named = tuple((column.stratum, table.horizons_s[column.step]) for column in columns)
    decimals = columns[0].output.decimals
    rows = tuple(
        TrainingsRow(
            _name_of_all(rows),
            tuple(row.key for row in rows),
            len(rows),
            tuple(_spread_cell([row.cells[i].value for row in rows], decimals) for i in at),
            "",
        )
        for rows in found
    )
    return TrainingsTable(columns[0].output.title, "", named, 0, rows)


def _name_of_all(rows: Sequence[TableRow]) -> str:
    """The common label of the rows, else the name of their tracker."""
    labels = {row.label for row in rows}
    return rows[0].shown_label if len(labels) == 1 else rows[0].entry.tracker


def _weights_of(run: ReportedRun, label: str) -> str:
    """The hashes of the weights of a row on all recordings; empty if it has none."""
    used = run.record.weights
    return " ".join(used[name].sha256 for one in run.recordings if (name := f"{label}@{one}") in used)


def _spread_cell(values: Sequence[float | None], decimals: int) -> TrainingsCell:
    defined = [value for value in values if value is not None]
    if len(defined) < len(values):
        return TrainingsCell(UNDEFINED, "")
    mean, spread, low, high = (
        f"{one:.{decimals}f}" for one in (fmean(defined), stdev(defined), min(defined), max(defined))
    )
    return TrainingsCell(mean, f"± {spread}", f"{low} to {high}")
