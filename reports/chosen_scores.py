"""What an exported report shows: the rows and the scores that a user chose, or those of the headline table."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

from gridtrack.common.errors import ConfigurationError, did_you_mean
from gridtrack.common.grid import nearest_step
from gridtrack.evaluation.results.trial_summary import TrialSummary, better_direction
from gridtrack.evaluation.scoring.strata import STRATA_WITH_TRUTH
from gridtrack.reports.differences import DifferenceTable, difference_table
from gridtrack.reports.main_result import lead_of
from gridtrack.reports.patterns import names_matching
from gridtrack.reports.run import ReportedRun
from gridtrack.reports.score_frames import SCORES
from gridtrack.reports.table import (
    DETAIL_HORIZON_S,
    HeadlineTable,
    TableCell,
    TableColumn,
    TableRow,
    headline_tables,
    horizon_text,
    with_best,
)

_STRATA = "|".join(re.escape(name) for name in sorted(STRATA_WITH_TRUTH, key=len, reverse=True))
COLUMN = re.compile(rf"(?P<score>\w+) +(?P<stratum>{_STRATA}|[\w-]+)(?: +(?P<horizon>\d+(?:\.\d+)?) ?s)?", re.ASCII)
"""A stratum first by its whole name, which may have spaces and end in seconds: `occluded to 0.5 s`."""
EXPECTED = "expected SCORE STRATUM HORIZON, such as 'f1 in-motion 1s'"
NAMES = {"f1": "F1", "pr_auc": "PR-AUC", "brier": "Brier", "nll": "log loss", "ece": "ECE", "soft_iou": "soft IoU"}


@dataclass(frozen=True)
class ScoreChoice:
    """A score of cells of one stratum at one horizon, seconds, by its name in summary.json; it is shown at the step
    nearest to the horizon, under the time of the step."""

    score: str
    stratum: str
    horizon_s: float

    @property
    def heading(self) -> str:
        """The name of the score and the stratum."""
        return f"{NAMES.get(self.score, self.score.replace('_', ' '))}, {self.stratum}"


@dataclass(frozen=True)
class ExportedTable:
    """The table of one recording, as it was chosen."""

    table: HeadlineTable
    lead: str
    """The main result of the whole comparison in a sentence; empty where there is none."""
    differences: DifferenceTable | None
    """The paired differences of the rows shown; None where there are none, or several runs."""


def parse_score_choices(text: str) -> tuple[ScoreChoice, ...]:
    """Scores from `f1 in-motion 1s, nll visible`; without a horizon, at 1 s. Raises ConfigurationError."""
    return tuple(_parse_choice(part.strip()) for part in text.split(","))


def _parse_choice(text: str) -> ScoreChoice:
    found = COLUMN.fullmatch(text)
    if found is None:
        raise ConfigurationError(f"--columns '{text}': {EXPECTED}")
    if found["score"] not in SCORES:
        raise ConfigurationError(f"--columns '{text}': no score '{found['score']}': {did_you_mean(found[1], SCORES)}")
    return ScoreChoice(found["score"], found["stratum"], float(found["horizon"] or DETAIL_HORIZON_S))


def exported_tables(runs: Sequence[ReportedRun], rows: str = "", columns: str = "") -> tuple[ExportedTable, ...]:
    """The table of each recording, and first of all pooled: its rows whose labels match one of `rows`, in `columns`.

    `rows`: patterns of labels as of file names, separated by commas; `columns`: as of parse_score_choices. Empty: those
    of the headline table. Raises ConfigurationError where nothing matches, RunError and ReportError.
    """
    choices = parse_score_choices(columns) if columns else ()
    labels = names_matching(rows or "*", [label for run in runs for label in run.summary.trackers], "--rows", "row")
    _check_strata(runs, choices)
    exported = (_exported(runs, table, labels, choices) for table in headline_tables(runs))
    return tuple(one for one in exported if one.table.rows)


def _check_strata(runs: Sequence[ReportedRun], choices: Sequence[ScoreChoice]) -> None:
    trials = [trial for run in runs for row in run.summary.trackers.values() for trial in row.recordings.values()]
    strata = {stratum for trial in trials for stratum in trial.strata}
    for choice in choices:
        if choice.stratum not in strata:
            near = did_you_mean(choice.stratum, strata)
            raise ConfigurationError(f"--columns: the run has no stratum '{choice.stratum}': {near}")


def _exported(
    runs: Sequence[ReportedRun], table: HeadlineTable, labels: Collection[str], choices: Sequence[ScoreChoice]
) -> ExportedTable:
    columns = tuple(_column(choice, table.horizons_s) for choice in choices) or table.columns
    shown = [row for row in table.rows if row.label in labels]
    if choices:
        shown = [replace(row, cells=tuple(_cell(column, row.trial) for column in columns)) for row in shown]
    else:
        shown = [replace(row, cells=tuple(replace(cell, best=False) for cell in row.cells)) for row in shown]
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


def _column(choice: ScoreChoice, horizons_s: Sequence[float]) -> TableColumn:
    """The column of a choice, at the nearest step. Raises ConfigurationError where the run does not reach it."""
    step = nearest_step(choice.horizon_s, horizons_s[1] - horizons_s[0])
    if step >= len(horizons_s):
        raise ConfigurationError(f"--columns: {choice.horizon_s:g} s is beyond the horizon of {horizons_s[-1]:g} s")
    heading, better = horizon_text(horizons_s[step]), better_direction(choice.score)
    return TableColumn(choice.heading, heading, choice.stratum, choice.score, step, better)


def _cell(column: TableColumn, trial: TrialSummary) -> TableCell:
    """A score with its interval, whichever score it is."""
    scores = trial.strata.get(column.stratum)
    if scores is None:
        return TableCell(None)
    ends = [f"{column.score}_{end}" for end in ("low", "high")]
    low, high = (scores.at(end, column.step) if end in SCORES else None for end in ends)
    return TableCell(column.of(trial), interval=None if low is None or high is None else (low, high))
