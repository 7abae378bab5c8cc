"""Shares of the way from the floors to the oracle."""

from __future__ import annotations

from dataclasses import dataclass

from gridtrack.evaluation.results.trial_summary import StratumScores
from gridtrack.reports.table import HeadlineTable, TableRow

SHARED = ("in-motion", "dynamic", "visible", "occluded")
"""Strata whose shares are shown, where they are scored."""


@dataclass(frozen=True)
class CeilingRow:
    """One tracker's shares of F1 and of log loss, by stratum; None where a share is undefined."""

    row: TableRow
    shares: tuple[tuple[float | None, float | None], ...]


@dataclass(frozen=True)
class CeilingTable:
    """The shares of every tracker at the decisive horizon."""

    horizon: str
    strata: tuple[str, ...]
    rows: tuple[CeilingRow, ...]


def ceiling_table(table: HeadlineTable) -> CeilingTable | None:
    """The table of a recording with an oracle; None for one without."""
    rows = [row for row in table.rows if any(s.share_of_oracle is not None for s in row.trial.strata.values())]
    if not rows:
        return None
    names = tuple(name for name in SHARED if any(name in row.trial.strata for row in rows))
    step = table.decisive.step
    cells = (tuple(_shares(row.trial.strata.get(name), step) for name in names) for row in rows)
    return CeilingTable(
        table.decisive.heading, names, tuple(CeilingRow(row, shares) for row, shares in zip(rows, cells, strict=True))
    )


def _shares(scores: StratumScores | None, step: int) -> tuple[float | None, float | None]:
    """The shares of F1 and of log loss at `step`."""
    f1, nll = (scores.share_of_oracle, scores.share_of_oracle_nll) if scores else (None, None)
    return f1[step] if f1 else None, nll[step] if nll else None
