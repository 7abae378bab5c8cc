"""Scores under a deadline and on degraded input, as tables and small figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from gridtrack.evaluation.results.passes import Deadline
from gridtrack.evaluation.results.values import Curves
from gridtrack.reports.figures import Series
from gridtrack.reports.sweeps import SweepPanel, series_of, sweep_panel
from gridtrack.reports.table import MAIN_STRATUM, HeadlineTable, TableColumn, TableRow

SWEEP_STRATA = (MAIN_STRATUM, "visible")
DEGRADATION_TEXTS = {
    "beam_dropout": ("beams without a return", ""),
    "range_noise": ("range noise", " m"),
    "frame_drop": ("frames dropped", ""),
    "pose_jitter": ("pose jitter", " m"),
}
"""The name of each kind of degradation on the page, and its unit of measurement."""
HIGHEST_HZ = 1000.0
"""Higher rates are shown as `> 1000`: no stream has them."""


@dataclass(frozen=True)
class DeadlineRow:
    """One tracker under a deadline: its times, and for each rate its F1 and the share of frames that it missed."""

    row: TableRow
    deadline: Deadline
    untimed: float | None
    at_rates: tuple[tuple[float | None, float], ...]

    @property
    def highest_rate(self) -> str:
        """The highest rate of frames that the tracker processes in time, Hz."""
        hz = self.deadline.highest_rate_hz
        return f"> {HIGHEST_HZ:g}" if hz > HIGHEST_HZ else f"{hz:.3g}"


@dataclass(frozen=True)
class DeadlineTable:
    """F1 under a deadline, of cells in motion at the shortest horizon of the table: delays change these first."""

    column: TableColumn
    rates: tuple[tuple[float, float], ...]
    """Each rate as a multiple of the stream's, and in Hz."""
    rows: tuple[DeadlineRow, ...]
    panels: tuple[SweepPanel, ...]


@dataclass(frozen=True)
class RobustnessTable:
    """F1 on degraded input at the shortest horizon of the table: a panel for each stratum and kind of degradation."""

    column: TableColumn
    panels: tuple[SweepPanel, ...]

    @property
    def series(self) -> tuple[Series, ...]:
        """Every tracker that a panel shows, once."""
        return series_of(self.panels)


def deadline_table(table: HeadlineTable, styles: Mapping[str, str]) -> DeadlineTable | None:
    """The table of every trial with scores under a deadline; None where there is none."""
    known = [(row, row.trial.deadline) for row in table.rows if row.trial.deadline and row.trial.strata]
    if not known:
        return None
    column = _first_of_f1(table)
    rates = tuple((at.rate, at.rate_hz) for at in known[0][1].rates)
    shown = [(row, deadline) for row, deadline in known if tuple((a.rate, a.rate_hz) for a in deadline.rates) == rates]
    rows = tuple(
        DeadlineRow(
            row,
            deadline,
            column.of(row.trial),
            tuple((_f1_at(at.f1, column.stratum, column.step), at.missed / max(at.frames, 1)) for at in deadline.rates),
        )
        for row, deadline in shown
    )
    names = ("untimed", *(f"×{rate:g}" for rate, _ in rates))
    panels = tuple(
        sweep_panel(
            "F1",
            f"{stratum} cells, {column.heading} ahead",
            [(float(i), name) for i, name in enumerate(names)],
            [
                (
                    Series(row.label, row.name, styles[row.label]),
                    (
                        _f1_at({name: scores.f1 for name, scores in row.trial.strata.items()}, stratum, column.step),
                        *(_f1_at(at.f1, stratum, column.step) for at in deadline.rates),
                    ),
                )
                for row, deadline in shown
            ],
        )
        for stratum in SWEEP_STRATA
    )
    return DeadlineTable(column, rates, rows, panels)


def robustness_table(table: HeadlineTable, styles: Mapping[str, str]) -> RobustnessTable | None:
    """The panels of every trial with scores on degraded input; None where there is none."""
    column = _first_of_f1(table)
    known = [(row, row.trial.robustness) for row in table.rows if row.trial.robustness]
    panels = []
    for stratum in SWEEP_STRATA:
        for kind in dict.fromkeys(kind for _, robustness in known for kind in robustness.kinds):
            curves = [(row, robustness.kinds[kind]) for row, robustness in known if kind in robustness.kinds]
            values = tuple(point.value for point in curves[0][1])
            words, unit = DEGRADATION_TEXTS.get(kind, (kind, ""))
            panels.append(
                sweep_panel(
                    "F1",
                    f"{stratum} cells; {words}",
                    [(value, f"{value:.3g}{unit if value == values[-1] else ''}") for value in values],
                    [
                        (
                            Series(row.label, row.name, styles[row.label]),
                            tuple(_f1_at(p.f1, stratum, column.step) for p in points),
                        )
                        for row, points in curves
                        if tuple(p.value for p in points) == values
                    ],
                )
            )
    return RobustnessTable(column, tuple(panels)) if panels else None


def _first_of_f1(table: HeadlineTable) -> TableColumn:
    """The first column of F1; with few statistical units those of PR-AUC come before it."""
    return next(column for column in table.columns if column.score == "f1")


def _f1_at(f1: Curves, stratum: str, step: int) -> float | None:
    return f1[stratum][step] if stratum in f1 else None
