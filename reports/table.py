"""The headline table of page and terminal: one row per tracker, with the main scores of a comparison."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Literal

from gridtrack.common.grid import nearest_step
from gridtrack.evaluation.results.summary import TrackerSummary
from gridtrack.evaluation.results.trial_summary import TrialSummary
from gridtrack.evaluation.statistics.score_intervals import HEADLINE_HORIZONS_S, HEADLINE_STRATA
from gridtrack.reports.markdown import cell_text, markdown_table
from gridtrack.reports.run import UNDEFINED, ReportedRun, ReportError

FORGIVING = "fss_5"
"""The score that forgives a few cells in the table: the others are in a section of their own."""
FORGIVING_NAME = "FSS, 5 cells"
DETAIL_HORIZON_S = 1.0
"""The horizon of the other scores, by which the rows are sorted too."""
MAIN_STRATUM = HEADLINE_STRATA[0]
"""The stratum of the other scores, by which the rows are sorted too."""
STANDING = "standing"
"""A stratum outside the headline family: F1 at the detail horizon is a column beside the others."""

LEAK = "learned from these frames"
"""The mark of a row whose weights learned from frames that it is scored on."""

RowGroup = Literal["ceiling", "ranked", "floor", "unranked"]
"""The ceiling; complete trials of trackers; complete trials of the floor; trials that are not complete, or scored on
frames that they learned from."""


@dataclass(frozen=True)
class TableColumn:
    """A score at one step: its headings, its name in summary.json, and the better direction (1, -1; 0: neither)."""

    group: str
    heading: str
    stratum: str
    score: str
    step: int
    better: int = 1

    @property
    def score_name(self) -> str:
        """Its name in a sentence."""
        return "PR-AUC" if self.score == "pr_auc" else "F1"

    def of(self, trial: TrialSummary) -> float | None:
        """Its value for one trial; None where it is undefined."""
        scores = trial.strata.get(self.stratum)
        return None if scores is None else scores.at(self.score, self.step)

    def interval_of(self, trial: TrialSummary) -> tuple[float, float] | None:
        """The confidence interval of an F1, PR-AUC or FSS; None where there is none, and for every other score."""
        scores = trial.strata.get(self.stratum)
        if scores is None or self.score not in ("f1", "pr_auc", FORGIVING):
            return None
        low, high = (scores.at(f"{self.score}_{end}", self.step) for end in ("low", "high"))
        return None if low is None or high is None else (low, high)


@dataclass(frozen=True)
class TableCell:
    """One score, its confidence interval, and whether it is the best of its column among complete trials."""

    value: float | None
    best: bool = False
    interval: tuple[float, float] | None = None

    @property
    def text(self) -> str:
        """Three decimals, or a dash where the score is undefined."""
        return UNDEFINED if self.value is None else f"{self.value:.3f}"

    @property
    def interval_text(self) -> str:
        """The interval in brackets; empty where there is none."""
        return "" if self.interval is None else f"[{self.interval[0]:.3f}, {self.interval[1]:.3f}]"


def outcome_words(trial: TrialSummary) -> str:
    """The outcome of a trial, and whether it learned from frames that it is scored on."""
    return f"{trial.outcome}, {LEAK}" if trial.leak else trial.outcome


def joined_names(names: Sequence[str]) -> str:
    """`A`, `A and B` or `A, B and C`."""
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))


def row_key(run: str, label: str) -> str:
    """A row's label after the name of its run; that is empty on the page of one run."""
    return f"{run}: {label}" if run else label


def name_of(label: str, trial: TrialSummary) -> str:
    """The label as it is shown: with a word where the weights are general."""
    return f"{label} (general)" if "general" in trial.card else label


def name_in(run: ReportedRun, label: str, recording: str) -> str:
    """The same of a row of a run on a recording, or of what is pooled."""
    entry = run.summary.trackers.get(label)
    trial = entry.recordings.get(recording) if entry else None
    return name_of(label, trial) if trial else label


@dataclass(frozen=True)
class TableRow:
    """One tracker on one recording."""

    run: str
    label: str
    entry: TrackerSummary
    trial: TrialSummary
    group: RowGroup
    cells: tuple[TableCell, ...]

    @property
    def key(self) -> str:
        """What tells the row from all others on the page."""
        return row_key(self.run, self.label)

    @property
    def name(self) -> str:
        """The label as it is shown, and before it the name of the run where there are several."""
        return row_key(self.run, name_of(self.label, self.trial))

    @property
    def trials(self) -> tuple[TrialSummary, ...]:
        """The trials of a pooled row on the recordings themselves."""
        return tuple(trial for trial in self.entry.recordings.values() if trial is not self.trial)

    @property
    def outcome(self) -> str:
        """The outcome of the trial; of a pooled row of which nothing was scored, those of its trials."""
        if self.trial.outcome == "partial" and not self.trial.frames_scored:
            return ", ".join(dict.fromkeys(map(outcome_words, self.trials)))
        return outcome_words(self.trial)

    @property
    def frames(self) -> str:
        """Frames scored, of those expected where they differ."""
        scored, expected = self.trial.frames_scored, self.trial.frames_expected
        return str(scored) if scored == expected else f"{scored} of {expected}"


@dataclass(frozen=True)
class HeadlineTable:
    """The table of one recording: the ceiling, ranked rows, the floor, rows that are not ranked."""

    recording: str
    columns: tuple[TableColumn, ...]
    rows: tuple[TableRow, ...]
    decisive: TableColumn
    """The column that rows are sorted by."""
    comparable: bool
    """Whether all rows are scored on the same frames: only then the best are marked."""
    pooled: bool
    """Whether it is pooled over all recordings."""
    horizons_s: tuple[float, ...]
    """The horizons that every run has, seconds."""

    @property
    def has_intervals(self) -> bool:
        """Whether any cell has an interval."""
        return any(cell.interval for row in self.rows for cell in row.cells)

    @property
    def groups(self) -> tuple[tuple[str, int], ...]:
        """The headings of the groups of columns, and the number of columns in each."""
        return tuple((group, len(list(columns))) for group, columns in groupby(self.columns, key=lambda c: c.group))

    def rows_in(self, group: RowGroup) -> tuple[TableRow, ...]:
        """The rows of one group."""
        return tuple(row for row in self.rows if row.group == group)


def headline_tables(runs: Sequence[ReportedRun]) -> tuple[HeadlineTable, ...]:
    """One table per recording; the rows of several runs are in the same table, each with the name of its run."""
    names = dict.fromkeys(name for run in runs for name in run.summary.recordings)
    return tuple(_headline_table(runs, name) for name in names)


def main_tables(tables: Sequence[HeadlineTable]) -> Sequence[HeadlineTable]:
    """The table pooled over all recordings, where there is one; else all tables."""
    return [table for table in tables if table.pooled] or tables


def _headline_table(runs: Sequence[ReportedRun], recording: str) -> HeadlineTable:
    shown = [run for run in runs if recording in run.summary.recordings]
    intervals, forgiving = (_has_any(shown, recording, score) for score in ("f1_low", FORGIVING))
    horizons_s = _common_horizons(shown, recording)
    columns = tuple(_columns(horizons_s, intervals, forgiving))
    decisive = next(i for i, column in enumerate(columns) if column.step == columns[-1].step)
    rows = [
        _table_row(run.name if len(runs) > 1 else "", label, entry, entry.recordings[recording], columns)
        for run in shown
        for label, entry in run.summary.trackers.items()
        if recording in entry.recordings
    ]
    order, labels = ("ceiling", "ranked", "floor", "unranked"), list(dict.fromkeys(row.label for row in rows))
    rows.sort(
        key=lambda row: (
            order.index(row.group),
            -_or_least(row.cells[decisive].value),
            labels.index(row.label),
        )
    )
    comparable = _same_frames(shown, recording)
    pooled = any(run.is_pooled(recording) for run in shown)
    if comparable:
        rows = list(with_best(rows, columns))
    return HeadlineTable(recording, columns, tuple(rows), columns[decisive], comparable, pooled, horizons_s)


def _common_horizons(runs: Sequence[ReportedRun], recording: str) -> tuple[float, ...]:
    """The horizons that every run has. Raises ReportError where their rates differ."""
    stretches = [run.summary.recordings[recording] for run in runs]
    for run, stretch in zip(runs, stretches, strict=True):
        if abs(stretch.period_s - stretches[0].period_s) > 1e-6:
            rates = f"{1 / stretches[0].period_s:.3g} and {1 / stretch.period_s:.3g} Hz"
            raise ReportError(
                f"{recording} runs at {rates} in {runs[0].name} and {run.name}: compare them again with one --rate"
            )
    return min((stretch.horizons_s for stretch in stretches), key=len)


def _same_frames(runs: Sequence[ReportedRun], recording: str) -> bool:
    described = [(run.summary.recordings[recording], run.identity_of(recording)) for run in runs]
    return all(stretch.parity for stretch, _ in described) and described.count(described[0]) == len(described)


def _has_any(runs: Sequence[ReportedRun], recording: str, curve: str) -> bool:
    """Whether any row has this curve: intervals it has from LEAST_UNITS statistical units on."""
    trials = [
        e.recordings[recording] for run in runs for e in run.summary.trackers.values() if recording in e.recordings
    ]
    return any(getattr(scores, curve) is not None for trial in trials for scores in trial.strata.values())


def _columns(horizons_s: Sequence[float], intervals: bool, forgiving: bool) -> Iterator[TableColumn]:
    """F1 at the headline horizons (at the last horizon where the run reaches none), and the other scores at one.

    Without intervals a score that needs no threshold is first: few frames choose a threshold poorly.
    """
    period_s = horizons_s[1] - horizons_s[0]
    wanted = [nearest_step(h, period_s) for h in HEADLINE_HORIZONS_S]
    steps = sorted({step for step in wanted if 0 < step < len(horizons_s)}) or [len(horizons_s) - 1]
    if not intervals:
        for step in steps:
            heading = horizon_text(horizons_s[step])
            yield TableColumn(f"PR-AUC, {MAIN_STRATUM}", heading, MAIN_STRATUM, "pr_auc", step)
    for stratum in HEADLINE_STRATA:
        for step in steps:
            yield TableColumn(f"F1, {stratum}", horizon_text(horizons_s[step]), stratum, "f1", step)
    step = nearest_step(DETAIL_HORIZON_S, period_s)
    step = step if step in steps else steps[0]
    yield TableColumn(f"F1, {STANDING}", horizon_text(horizons_s[step]), STANDING, "f1", step)
    group = f"{MAIN_STRATUM}, {horizon_text(horizons_s[step])}"
    yield TableColumn(group, "precision", MAIN_STRATUM, "precision", step, 0)
    yield TableColumn(group, "recall", MAIN_STRATUM, "recall", step, 0)
    if intervals:
        yield TableColumn(group, "PR-AUC", MAIN_STRATUM, "pr_auc", step)
    if forgiving:
        yield TableColumn(group, FORGIVING_NAME, MAIN_STRATUM, FORGIVING, step)
    yield TableColumn(group, "log loss", MAIN_STRATUM, "nll", step, -1)
    yield TableColumn(group, "Brier", MAIN_STRATUM, "brier", step, -1)


def horizon_text(horizon_s: float) -> str:
    """A horizon as in the headings."""
    return f"{horizon_s:.3g} s"


def _table_row(
    run: str, label: str, entry: TrackerSummary, trial: TrialSummary, columns: Sequence[TableColumn]
) -> TableRow:
    cells = tuple(TableCell(column.of(trial), interval=column.interval_of(trial)) for column in columns)
    return TableRow(run, label, entry, trial, _group_of(entry, trial), cells)


def _group_of(entry: TrackerSummary, trial: TrialSummary) -> RowGroup:
    if not trial.ranked:
        return "unranked"
    return "ceiling" if entry.ceiling else "floor" if entry.floor else "ranked"


def _or_least(value: float | None) -> float:
    return -1.0 if value is None else value


def with_best(rows: Sequence[TableRow], columns: Sequence[TableColumn]) -> Iterator[TableRow]:
    """Mark the best complete trials of each column; values that are equal to the digits shown are equally good."""
    best: list[str | None] = []
    for i, column in enumerate(columns):
        values = [v for row in rows if row.group in ("ranked", "floor") and (v := row.cells[i].value) is not None]
        pick = max if column.better > 0 else min
        best.append(TableCell(pick(values)).text if len(values) > 1 and column.better else None)
    for row in rows:
        cells = (replace(cell, best=cell.text == top) for cell, top in zip(row.cells, best, strict=True))
        yield row if row.group in ("unranked", "ceiling") else replace(row, cells=tuple(cells))


def headline_markdown(table: HeadlineTable, text: Callable[[str], str] = cell_text) -> str:
    """The table as Markdown, with names as `text` writes them; the best values are bold."""
    headings = ["tracker", *(f"{c.group} {c.heading}" for c in table.columns), "frames", "outcome"]
    rows = [
        [text(row.name), *(_cell_markdown(cell) for cell in row.cells), row.frames, text(row.outcome)]
        for row in table.rows
    ]
    return markdown_table(headings, rows, aligned_right=range(1, len(headings) - 1))


def _cell_markdown(cell: TableCell) -> str:
    return f"{f'**{cell.text}**' if cell.best else cell.text} {cell.interval_text}".rstrip()
