"""Scores on occluded cells, by the time since a cell was last seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from gridtrack.evaluation.scoring.strata import OCCLUDED
from gridtrack.reports.table import HeadlineTable, TableRow


@dataclass(frozen=True)
class OccludedRow:
    """One tracker on occluded cells: F1 of each stratum, and F1 on visible less F1 on occluded cells; None where a
    score is undefined."""

    row: TableRow
    f1: tuple[float | None, ...]
    gap: float | None


@dataclass(frozen=True)
class OccludedTable:
    """The scores of every tracker on occluded cells, at the decisive horizon."""

    horizon: str
    strata: tuple[str, ...]
    rows: tuple[OccludedRow, ...]


def occluded_table(table: HeadlineTable) -> OccludedTable | None:
    """The table of a recording with ground truth; None for one without."""
    rows = [row for row in table.rows if OCCLUDED in row.trial.strata]
    if not rows:
        return None
    step = table.decisive.step
    names = tuple(dict.fromkeys(n for row in rows for n in row.trial.strata if n.startswith(OCCLUDED)))
    return OccludedTable(table.decisive.heading, names, tuple(_occluded_row(row, names, step) for row in rows))


def _occluded_row(row: TableRow, names: Sequence[str], step: int) -> OccludedRow:
    strata, gap = row.trial.strata, row.trial.gap_to_truth
    return OccludedRow(
        row,
        tuple(strata[name].f1[step] if name in strata else None for name in names),
        None if gap is None else gap[step],
    )
