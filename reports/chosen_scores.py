"""The tables of an exported report: the rows and scores that a user chose, or the main table's."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

from gridtrack.common.errors import ConfigurationError, did_you_mean
from gridtrack.common.grid import nearest_step
from gridtrack.evaluation.runs.finished import DETAIL_HORIZON_S
from gridtrack.evaluation.runs.summary import OutputDescription, ScoreDescription
from gridtrack.reports.decision import lead_of
from gridtrack.reports.differences import DifferenceTable, difference_table
from gridtrack.reports.run import ReportedRun, names_matching
from gridtrack.reports.table import (
    HeadlineTable,
    TableColumn,
    TableRow,
    headline_tables,
    horizon_text,
    with_best,
)

COLUMN = re.compile(r"(?P<score>[\w.]+) +(?P<cells>.+)", re.ASCII)
HORIZON = re.compile(r"(?P<stratum>.+?) +(?P<horizon>\d+(?:\.\d+)?) ?s", re.ASCII)
EXPECTED = "expected SCORE STRATUM HORIZON, such as 'f1 in-motion 1s' or 'f1.recall dynamic'"


@dataclass(frozen=True)
class ScoreChoice:
    """An output of a score on the cells of one stratum at one horizon, seconds; shown at the step nearest to it."""

    score: ScoreDescription
    output: OutputDescription
    stratum: str
    horizon_s: float

    def column(self, horizons_s: Sequence[float]) -> TableColumn:
        """Its column, under the time of the step. Raises ConfigurationError if the run does not reach it."""
        step = nearest_step(self.horizon_s, horizons_s[1] - horizons_s[0])
        if step >= len(horizons_s):
            raise ConfigurationError(f"--columns: {self.horizon_s:g} s is beyond the horizon of {horizons_s[-1]:g} s")
        group = f"{self.output.heading}, {self.stratum}"
        return TableColumn(group, horizon_text(horizons_s[step]), self.stratum, self.score, self.output, step)


@dataclass(frozen=True)
class ExportedTable:
    """The table of one recording, as it was chosen."""

    table: HeadlineTable
    lead: str
    """The main result of the whole comparison in a sentence; empty if there is none."""
    differences: DifferenceTable | None
    """The paired differences of the rows shown; None if there are none, or several runs."""


def exported_tables(runs: Sequence[ReportedRun], rows: str = "", columns: str = "") -> tuple[ExportedTable, ...]:
    """The table of each recording, pooled ones first: the rows with labels that match one of `rows`, in `columns`.

    `rows`: patterns like file names, separated by commas; `columns`: as in parse_score_choices. Empty: as in the main
    table. Raises ConfigurationError if nothing matches, RunError and ReportError.
    """
    choices = parse_score_choices(columns, runs) if columns else ()
    labels = names_matching(rows or "*", [label for run in runs for label in run.summary.trackers], "--rows", "row")
    exported = (_exported(runs, table, labels, choices) for table in headline_tables(runs))
    return tuple(one for one in exported if one.table.rows)


def parse_score_choices(text: str, runs: Sequence[ReportedRun]) -> tuple[ScoreChoice, ...]:
    """Scores of the runs from `f1 in-motion 1s, f1.recall visible`; without a horizon, at 1 s.

    Raises ConfigurationError.
    """
    trials = [trial for run in runs for row in run.summary.trackers.values() for trial in row.recordings.values()]
    strata = {stratum for trial in trials for stratum in trial.strata}
    return tuple(_parse_choice(part.strip(), runs, strata) for part in text.split(","))


def _parse_choice(text: str, runs: Sequence[ReportedRun], strata: Collection[str]) -> ScoreChoice:
    found = COLUMN.fullmatch(text)
    if found is None:
        raise ConfigurationError(f"--columns '{text}': {EXPECTED}")
    try:
        score, output = _described(found["score"], runs)
    except ConfigurationError as error:
        raise ConfigurationError(f"--columns '{text}': {error}") from None
    stratum, horizon_s = found["cells"].strip(), DETAIL_HORIZON_S
    at = None if stratum in strata else HORIZON.fullmatch(stratum)  # a stratum may end in seconds: `occluded to 0.5 s`
    if at is not None:
        stratum, horizon_s = at["stratum"], float(at["horizon"])
    if stratum not in strata:
        raise ConfigurationError(f"--columns: the run has no stratum '{stratum}': {did_you_mean(stratum, strata)}")
    return ScoreChoice(score, output, stratum, horizon_s)


def _described(name: str, runs: Sequence[ReportedRun]) -> tuple[ScoreDescription, OutputDescription]:
    """The score and output in the first run that has it. Raises ConfigurationError."""
    for run in runs[:-1]:
        try:
            return run.summary.find(name)
        except ConfigurationError:
            continue
    return runs[-1].summary.find(name)


def _exported(
    runs: Sequence[ReportedRun], table: HeadlineTable, labels: Collection[str], choices: Sequence[ScoreChoice]
) -> ExportedTable:
    columns = tuple(choice.column(table.horizons_s) for choice in choices) or table.columns
    shown = [
        replace(row, cells=tuple(column.cell(row.trial) for column in columns))
        for row in table.rows
        if row.label in labels
    ]
    if table.comparable:
        shown = list(with_best(shown, columns))
    chosen = replace(table, columns=columns, rows=tuple(shown))
    return ExportedTable(chosen, lead_of(runs, table), _differences(runs, table, shown))


def _differences(
    runs: Sequence[ReportedRun], table: HeadlineTable, shown: Sequence[TableRow]
) -> DifferenceTable | None:
    found = difference_table(runs[0], table.recording) if len(runs) == 1 else None
    labels = {row.label for row in shown}
    rows = tuple(row for row in found.rows if row.tracker in labels) if found else ()
    return replace(found, rows=rows) if found and rows else None
