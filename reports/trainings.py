"""Trackers with several trainings as a table: mean F1, spread between trainings, and differences judged with it."""

from __future__ import annotations

from dataclasses import dataclass

from gridtrack.evaluation.results.summary import TrackerTrainings, TrainingsScore
from gridtrack.reports.differences import interval_text, p_text
from gridtrack.reports.run import UNDEFINED, ReportedRun


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
    """One tracker; `count` trainings. `reason`: why its difference has no interval."""

    label: str
    count: int
    cells: tuple[TrainingsCell, ...]
    reason: str


@dataclass(frozen=True)
class TrainingsTable:
    """Every tracker by its trainings, on one recording or pooled over all."""

    reference: str
    columns: tuple[tuple[str, float], ...]
    """Stratum and horizon, seconds."""
    units: int
    rows: tuple[TrainingsRow, ...]


def trainings_table(run: ReportedRun, recording: str) -> TrainingsTable | None:
    """The table of one recording of a run; None where no tracker has several trainings."""
    found = [one for one in run.summary.trainings if one.recordings == recording]
    if not found:
        return None
    columns = tuple((score.stratum, score.horizon_s) for score in found[0].scores)
    return TrainingsTable(found[0].reference, columns, found[0].units, tuple(map(_row, found)))


def _row(one: TrackerTrainings) -> TrainingsRow:
    return TrainingsRow(one.labels[0], len(one.labels), tuple(map(_cell, one.scores)), one.interval)


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
