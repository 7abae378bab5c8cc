"""The main table of page, terminal and exports: one row per tracker, with the main scores of a comparison."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Literal

from gridtrack.evaluation.runs.finished import HEADLINE_STRATA, detail_step, headline_steps
from gridtrack.evaluation.runs.summary import (
    NO_ESTIMATE,
    OutputDescription,
    PointEstimate,
    ScoreDescription,
    TrackerSummary,
    TrialSummary,
)
from gridtrack.reports.markdown import escaped, markdown_table
from gridtrack.reports.run import UNDEFINED, ReportedRun, ReportError, output_name, scores_of

MAIN_STRATUM = HEADLINE_STRATA[0]
"""The stratum of the scores beside the headline score."""
STANDING = "standing"
"""A stratum without headline tests; its only column is the headline score at the detail horizon."""

LEAK = "learned from these frames"
"""The mark of a row if its weights learned from scored frames."""
MEMORY = "may remember"
"""The mark of a row with a sign that it remembers a recording."""

RECORDED = "recorded: causality not checked"
"""The mark of a row of recorded forecasts."""

RowGroup = Literal["ceiling", "ranked", "floor", "unranked"]
"""The ceiling; complete trials of trackers; complete trials of the floor; trials that are incomplete, or scored on
frames of their training."""


@dataclass(frozen=True)
class TableColumn:
    """An output of a score in one stratum at one step, and its headings."""

    group: str
    heading: str
    stratum: str
    score: ScoreDescription
    output: OutputDescription
    step: int

    @property
    def name(self) -> str:
        """The name of the output in options."""
        return output_name(self.score, self.output)

    @property
    def key(self) -> tuple[str, str]:
        """The names of the score and output."""
        return self.score.name, self.output.name

    @property
    def better(self) -> int:
        """1 if higher values are better, -1 if lower ones are, else 0."""
        return self.output.direction

    @property
    def title(self) -> str:
        """The title in a sentence: `log loss`, but `F1`."""
        title = self.output.title
        return title[:1].lower() + title[1:] if title[1:2].islower() else title

    @property
    def title_with_article(self) -> str:
        """`a log loss`, `an F1`: the sound of the first letter decides for an abbreviation."""
        vowels = "aeiou" if self.title[1:2].islower() else "AEFHILMNORSX"
        return f"{'an' if self.title[:1] in vowels else 'a'} {self.title}"

    def cell(self, trial: TrialSummary) -> TableCell:
        """The cell of one trial."""
        return TableCell(trial.at(self.stratum, *self.key, self.step), self.output.decimals)


@dataclass(frozen=True)
class TableCell:
    """One score with its confidence interval, and whether it is the best of its column among complete trials."""

    estimate: PointEstimate = NO_ESTIMATE
    decimals: int = 3
    best: bool = False

    @property
    def value(self) -> float | None:
        """The value; None if it is undefined."""
        return self.estimate.value

    @property
    def interval(self) -> tuple[float, float] | None:
        """The interval; None if there is none."""
        return self.estimate.interval

    @property
    def text(self) -> str:
        """The value to the score's decimals, or a dash if it is undefined."""
        return UNDEFINED if self.value is None else f"{self.value:.{self.decimals}f}"

    @property
    def interval_text(self) -> str:
        """The interval in brackets; empty if there is none."""
        if self.interval is None:
            return ""
        low, high = (f"{end:.{self.decimals}f}" for end in self.interval)
        return f"[{low}, {high}]"


def outcome_words(trial: TrialSummary) -> str:
    """The outcome of a trial, and whether it learned from scored frames."""
    return f"{trial.outcome}, {LEAK}" if trial.leak else trial.outcome


def row_key(run: str, label: str) -> str:
    """A row's label after the name of its run, which is empty on the page of one run."""
    return f"{run}: {label}" if run else label


def name_in(run: ReportedRun, label: str, recording: str) -> str:
    """The displayed label of a row of a run on a recording, or pooled.

    It says that the weights of a tracker are general where another tracker of the run has weights of the site.
    """
    entry = run.summary.trackers.get(label)
    trial = entry.recordings.get(recording) if entry and not entry.floor else None
    is_general = trial is not None and "general" in trial.card and run.has_site_weights
    return f"{label} (general)" if is_general else label


@dataclass(frozen=True)
class TableRow:
    """One tracker on one recording."""

    run: str
    label: str
    shown_label: str
    entry: TrackerSummary
    trial: TrialSummary
    group: RowGroup
    cells: tuple[TableCell, ...]

    @property
    def key(self) -> str:
        """A key of the row, unique on the page."""
        return row_key(self.run, self.label)

    @property
    def name(self) -> str:
        """The displayed label, after the name of the run if there are several."""
        return row_key(self.run, self.shown_label)

    @property
    def trials(self) -> tuple[TrialSummary, ...]:
        """The trials of a pooled row on the recordings themselves."""
        return tuple(trial for trial in self.entry.recordings.values() if trial is not self.trial)

    @property
    def outcome(self) -> str:
        """The outcome of the trial; for a pooled row without scores, the outcomes of its trials."""
        if self.trial.outcome == "partial" and not self.trial.frames_scored:
            return ", ".join(dict.fromkeys(map(outcome_words, self.trials)))
        return outcome_words(self.trial)

    @property
    def remark(self) -> str:
        """The outcome of a row without a rank; else the best floor if the tracker is below it, and a memory."""
        if self.group == "unranked":
            return self.outcome
        below = f"below {self.trial.best_floor}" if self.trial.below_floor else ""
        recorded = (self.trial.made_by, RECORDED) if self.entry.role == "recorded" else ()
        return ", ".join(filter(None, (below, MEMORY if self.trial.memory else "", *recorded)))

    @property
    def frames(self) -> str:
        """The number of scored frames, and of expected ones if it differs."""
        scored, expected = self.trial.frames_scored, self.trial.frames_expected
        return str(scored) if scored == expected else f"{scored} of {expected}"


@dataclass(frozen=True)
class HeadlineTable:
    """The table of one recording: the ceiling, ranked rows, the floor, rows that are not ranked."""

    recording: str
    columns: tuple[TableColumn, ...]
    rows: tuple[TableRow, ...]
    decisive: TableColumn
    """The column that orders the rows."""
    headline: tuple[str, str]
    """The names of the headline score and its output."""
    scores: tuple[ScoreDescription, ...]
    """The scores of all runs."""
    comparable: bool
    """Whether all rows are scored on the same frames: only then the best are marked."""
    pooled: bool
    """Whether it is pooled over all recordings."""
    horizons_s: tuple[float, ...]
    """The common horizons of all runs, seconds."""

    @property
    def has_intervals(self) -> bool:
        """Whether any cell has an interval."""
        return any(cell.interval for row in self.rows for cell in row.cells)

    @property
    def groups(self) -> tuple[tuple[str, int], ...]:
        """The headings of the groups of columns, and the number of columns in each."""
        return tuple((group, len(list(own))) for group, own in groupby(self.columns, key=lambda column: column.group))

    def rows_in(self, group: RowGroup) -> tuple[TableRow, ...]:
        """The rows of one group."""
        return tuple(row for row in self.rows if row.group == group)


def headline_tables(runs: Sequence[ReportedRun]) -> tuple[HeadlineTable, ...]:
    """One table per recording; the rows of several runs are in the same table, each with the name of its run."""
    names = dict.fromkeys(name for run in runs for name in run.summary.recordings)
    return tuple(_headline_table(runs, name) for name in names)


def main_tables(tables: Sequence[HeadlineTable]) -> Sequence[HeadlineTable]:
    """The table pooled over all recordings, if there is one; else all tables."""
    return [table for table in tables if table.pooled] or tables


def _headline_table(runs: Sequence[ReportedRun], recording: str) -> HeadlineTable:
    shown = [run for run in runs if recording in run.summary.recordings]
    horizons_s = _common_horizons(shown, recording)
    entries = [
        (run.name if len(runs) > 1 else "", label, name_in(run, label, recording), entry, entry.recordings[recording])
        for run in shown
        for label, entry in run.summary.trackers.items()
        if recording in entry.recordings
    ]
    columns = tuple(_columns(shown, [trial for *_, trial in entries], horizons_s))
    decisive = min(columns, key=lambda column: abs(column.step - detail_step(horizons_s)))
    rows = [
        TableRow(run, label, shown, entry, trial, _group_of(entry, trial), tuple(one.cell(trial) for one in columns))
        for run, label, shown, entry, trial in entries
    ]
    comparable = _same_frames(shown, recording)
    if comparable:
        rows = list(with_best(rows, columns))
    return HeadlineTable(
        recording,
        columns,
        tuple(_sorted(rows, columns.index(decisive), decisive.better)),
        decisive,
        _headline_of(shown),
        tuple(scores_of(shown).values()),
        comparable,
        any(run.is_pooled(recording) for run in shown),
        horizons_s,
    )


def _sorted(rows: Sequence[TableRow], at: int, better: int) -> list[TableRow]:
    """The rows by group, the best in the column `at` first; equal rows keep their order."""
    order, labels = ("ceiling", "ranked", "floor", "unranked"), list(dict.fromkeys(row.label for row in rows))

    def place(row: TableRow) -> tuple[int, bool, float, int]:
        value = row.cells[at].value
        return order.index(row.group), value is None, -better * (value or 0.0), labels.index(row.label)

    return sorted(rows, key=place)


def _headline_of(runs: Sequence[ReportedRun]) -> tuple[str, str]:
    score, _, output = runs[0].summary.headline.partition(".")
    return score, output


def _common_horizons(runs: Sequence[ReportedRun], recording: str) -> tuple[float, ...]:
    """The common horizons of all runs. Raises ReportError if their rates differ."""
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


def _columns(
    runs: Sequence[ReportedRun], trials: Sequence[TrialSummary], horizons_s: Sequence[float]
) -> Iterator[TableColumn]:
    """The headline score in the strata that it has, at the horizons where it leads, or else at the last horizon, and
    the leading output of every other tested score in the main stratum at one horizon."""
    scores = scores_of(runs)
    name, output_of = _headline_of(runs)
    headline = scores.get(name, _unscored(name, output_of))
    output = next(one for one in headline.outputs if one.name == output_of)
    steps = sorted(step for _, step in headline_steps(horizons_s, headline.horizons_s)) or [len(horizons_s) - 1]
    detail = detail_step(horizons_s)
    for stratum in dict.fromkeys((headline.stratum, *HEADLINE_STRATA)):
        if stratum == headline.stratum or _is_given(trials, headline, output, stratum):
            yield from _over_horizons(stratum, headline, output, steps, horizons_s)
    yield from _over_horizons(STANDING, headline, output, [detail], horizons_s)
    group = f"{MAIN_STRATUM}, {horizon_text(horizons_s[detail])}"
    explaining = [(headline, one) for one in headline.outputs if not one.better and not one.of_trial]
    others = [(one, one.lead) for one in scores.values() if one.name != name and one.lead.tested]
    for score, one in (*explaining, *others):
        if _is_given(trials, score, one):
            yield TableColumn(group, one.heading, MAIN_STRATUM, score, one, detail)


def _over_horizons(
    stratum: str, score: ScoreDescription, output: OutputDescription, steps: Sequence[int], horizons_s: Sequence[float]
) -> Iterator[TableColumn]:
    for step in steps:
        yield TableColumn(f"{output.title}, {stratum}", horizon_text(horizons_s[step]), stratum, score, output, step)


def _unscored(name: str, output: str) -> ScoreDescription:
    """The headline score of a run without scores."""
    title = name.upper()
    lead = OutputDescription(name=output, title=title, better="higher")
    return ScoreDescription(name=name, title=title, thresholded=False, outputs=(lead,))


def _is_given(
    trials: Sequence[TrialSummary], score: ScoreDescription, output: OutputDescription, stratum: str = MAIN_STRATUM
) -> bool:
    """Whether any trial has a value of the output in the stratum."""
    found = (trial.estimate(stratum, score.name, output.name) for trial in trials)
    return any(value is not None for one in found if one is not None for value in one.value)


def horizon_text(horizon_s: float) -> str:
    """A horizon as in the headings."""
    return f"{horizon_s:.3g} s"


def _group_of(entry: TrackerSummary, trial: TrialSummary) -> RowGroup:
    if not trial.ranked:
        return "unranked"
    return "ceiling" if entry.ceiling else "floor" if entry.floor else "ranked"


def with_best(rows: Sequence[TableRow], columns: Sequence[TableColumn]) -> Iterator[TableRow]:
    """Mark the best complete trials of each column; trials with equal displayed digits are equally good."""
    best: list[str | None] = []
    for i, column in enumerate(columns):
        known = [row.cells[i] for row in rows if row.group in ("ranked", "floor") and row.cells[i].value is not None]
        pick = max if column.better > 0 else min
        texts = [cell.text for cell in known]
        best.append(pick(texts, key=float) if len(known) > 1 and column.better else None)
    for row in rows:
        cells = (replace(cell, best=cell.text == top) for cell, top in zip(row.cells, best, strict=True))
        yield row if row.group in ("unranked", "ceiling") else replace(row, cells=tuple(cells))


def headline_markdown(table: HeadlineTable) -> str:
    """The table as Markdown, with the best values in bold."""
    headings = ["tracker", *(f"{c.group} {c.heading}" for c in table.columns), "frames", "outcome"]
    rows = [
        [
            escaped(row.name),
            *(f"{f'**{c.text}**' if c.best else c.text} {c.interval_text}".rstrip() for c in row.cells),
            row.frames,
            escaped(row.remark or row.outcome),
        ]
        for row in table.rows
    ]
    return markdown_table(headings, rows, aligned_right=range(1, len(headings) - 1))
