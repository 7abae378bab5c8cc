"""The section of one recording on the page: tables, figures and player, laid out for the templates."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from gridtrack.evaluation.results.passes import Latency
from gridtrack.evaluation.results.trial_summary import StratumScores
from gridtrack.reports.ceiling import CeilingTable, ceiling_table
from gridtrack.reports.classes import ClassTables, class_tables
from gridtrack.reports.deadline_and_robustness import DeadlineTable, RobustnessTable, deadline_table, robustness_table
from gridtrack.reports.differences import DifferenceTable, difference_table
from gridtrack.reports.figures import Axis, Span, TimeScale, time_scale
from gridtrack.reports.occluded import OccludedTable, occluded_table
from gridtrack.reports.occluded_thresholds import OccludedThresholds, occluded_thresholds
from gridtrack.reports.player import Player, player_of
from gridtrack.reports.reliability import DIAGRAM_SIDE, LEAST_CELLS, ReliabilityDiagram, reliability_diagrams
from gridtrack.reports.run import ReportedRun
from gridtrack.reports.spatial import SpatialSection, spatial_section
from gridtrack.reports.table import MAIN_STRATUM, HeadlineTable, TableRow
from gridtrack.reports.trainings import TrainingsTable, trainings_table

TRACKER_COLOURS = 8
"""Further trackers repeat the colours, with broken lines."""
FLOOR_GREYS = 3
"""Floors beyond this many repeat the greys."""
TIME_WIDTH = 150.0
MARK_WIDTH = 70.0
MARKED_HORIZONS = 3


@dataclass(frozen=True)
class ThresholdMark:
    """F1 on cells in motion at one horizon, at the thresholds of this stratum and of all visible cells, and at 0.5.

    `at` and `at_half` are the positions of the first and the last in the figure.
    """

    threshold: float | None
    f1: float | None
    f1_at_visible: float | None
    f1_at_half: float | None
    f1_label_free: float | None
    at: float | None
    at_half: float | None


@dataclass(frozen=True)
class TimeRow:
    """The times of one tracker, and whether it keeps up with the stream."""

    row: TableRow
    latency: Latency | None
    update: Span | None
    predict: Span | None
    verdict: str


@dataclass(frozen=True)
class ScoreDetail:
    """Every score at one step: for each stratum the rows that have it, in the order of the headline table."""

    horizon: str
    step: int
    strata: tuple[tuple[str, tuple[tuple[TableRow, StratumScores], ...]], ...]


@dataclass(frozen=True)
class Section:
    """The content of the page for one recording."""

    table: HeadlineTable
    details: tuple[ScoreDetail, ...]
    differences: DifferenceTable | None
    """Only on the page of one run."""
    trainings: TrainingsTable | None
    threshold_horizons: tuple[str, ...]
    thresholds: tuple[tuple[TableRow, tuple[ThresholdMark, ...]], ...]
    period_ms: float
    time_scale: TimeScale
    times: tuple[TimeRow, ...]
    deadlines: DeadlineTable | None
    robustness: RobustnessTable | None
    player: Player | None
    ceiling: CeilingTable | None
    occluded: OccludedTable | None
    occluded_thresholds: OccludedThresholds | None
    classes: ClassTables | None
    spatial: SpatialSection | None
    reliability_diagrams: tuple[ReliabilityDiagram, ...]
    diagram_side: float = DIAGRAM_SIDE
    least_cells: int = LEAST_CELLS
    time_width: float = TIME_WIDTH
    mark_width: float = MARK_WIDTH

    @property
    def measured(self) -> bool:
        """Whether any tracker was timed."""
        return any(time.latency is not None for time in self.times)


def styles_of(runs: Sequence[ReportedRun]) -> dict[str, str]:
    """The style (CSS classes) of each label on the page: a colour for a tracker, a grey for the floor."""
    styles: dict[str, str] = {}
    coloured = floors = 0
    for run in runs:
        for label, entry in run.summary.trackers.items():
            if label in styles:
                continue
            if entry.ceiling:
                styles[label] = "ceiling"
            elif entry.floor:
                styles[label] = f"f{floors % FLOOR_GREYS}"
                floors += 1
            else:
                styles[label] = f"t{coloured % TRACKER_COLOURS}" + (" again" if coloured >= TRACKER_COLOURS else "")
                coloured += 1
    return styles


def section_of(
    runs: Sequence[ReportedRun], table: HeadlineTable, styles: Mapping[str, str]
) -> tuple[Section, tuple[str, ...]]:
    """The section of one recording, and notices of files that could not be read. Raises ReportError."""
    shown = [run for run in runs if table.recording in run.summary.recordings]
    described = shown[0].summary.recordings[table.recording]
    period_ms = described.period_s * 1e3
    scale = time_scale(_latency_quantiles(table.rows), period_ms, TIME_WIDTH)
    horizons, thresholds = _thresholds(table)
    player, notices = _player(runs, table)
    diagrams, unreadable = reliability_diagrams(runs, table)
    section = Section(
        table=table,
        details=tuple(_details(table)),
        differences=difference_table(runs[0], table.recording) if len(runs) == 1 else None,
        trainings=trainings_table(runs[0], table.recording) if len(runs) == 1 else None,
        threshold_horizons=horizons,
        thresholds=thresholds,
        period_ms=period_ms,
        time_scale=scale,
        times=tuple(_time_row(row, scale, period_ms) for row in table.rows),
        deadlines=deadline_table(table, styles),
        robustness=robustness_table(table, styles),
        player=player,
        ceiling=ceiling_table(table),
        occluded=occluded_table(table),
        occluded_thresholds=occluded_thresholds(table, runs[0] if len(runs) == 1 else None),
        classes=class_tables(table, runs[0] if len(runs) == 1 else None),
        spatial=spatial_section(table, described.grid, styles),
        reliability_diagrams=diagrams,
    )
    return section, (*notices, *unreadable)


def _details(table: HeadlineTable) -> Iterator[ScoreDetail]:
    strata = dict.fromkeys(name for row in table.rows for name in row.trial.strata)
    for column in table.columns:
        if column.score == "f1" and column.stratum == MAIN_STRATUM:
            scores = ((n, tuple((r, r.trial.strata[n]) for r in table.rows if n in r.trial.strata)) for n in strata)
            yield ScoreDetail(column.heading, column.step, tuple(scores))


def _thresholds(table: HeadlineTable) -> tuple[tuple[str, ...], tuple[tuple[TableRow, tuple[ThresholdMark, ...]], ...]]:
    columns = [c for c in table.columns if c.score == "f1" and c.stratum == MAIN_STRATUM][:MARKED_HORIZONS]
    rows = [row for row in table.rows if MAIN_STRATUM in row.trial.strata and row.trial.threshold_chosen_on]
    strata = [row.trial.strata[MAIN_STRATUM] for row in rows]
    f1 = [v for s in strata for c in columns for v in (s.f1[c.step], s.f1_at_half[c.step]) if v is not None]
    axis = Axis(0.0, max(f1, default=0.0) or 1.0, 5.0, MARK_WIDTH - 5.0)
    return tuple(c.heading for c in columns), tuple((r, tuple(_mark(r, c.step, axis) for c in columns)) for r in rows)


def _mark(row: TableRow, step: int, axis: Axis) -> ThresholdMark:
    scores = row.trial.strata[MAIN_STRATUM]
    f1, half = scores.f1[step], scores.f1_at_half[step]
    at, at_half = (None if value is None else axis(value) for value in (f1, half))
    label_free = scores.at("f1_label_free", step)
    return ThresholdMark(scores.threshold[step], f1, scores.f1_at_visible[step], half, label_free, at, at_half)


def _latency_quantiles(rows: Iterable[TableRow]) -> list[float]:
    latencies = [row.trial.latency_ms for row in rows if row.trial.latency_ms]
    return [t for latency in latencies for q in (latency.update, latency.predict) for t in (q.p50, q.p95, q.p99) if t]


def _time_row(row: TableRow, scale: TimeScale, period_ms: float) -> TimeRow:
    latency = row.trial.latency_ms
    if latency is None:
        return TimeRow(row, None, None, None, "not measured")
    return TimeRow(row, latency, scale.span(latency.update), scale.span(latency.predict), keeps_up(latency, period_ms))


def keeps_up(latency: Latency, period_ms: float) -> str:
    """Whether a tracker keeps up with the stream: its 99th percentiles against the period."""
    update, predict = latency.update.p99, latency.predict.p99
    if update + predict <= period_ms:
        return "yes"
    return "updates only" if update <= period_ms else "no"


def _player(runs: Sequence[ReportedRun], table: HeadlineTable) -> tuple[Player | None, tuple[str, ...]]:
    """The player; none on the page of several runs, and none of pooled recordings."""
    if len(runs) > 1 or table.pooled:
        return None, ()
    (run,) = runs
    folders = {row.label: run.trial_folder(row.label, table.recording) for row in table.rows}
    horizons_s = run.summary.recordings[table.recording].horizons_s
    return player_of(table, folders, horizons_s, len(run.recordings))
