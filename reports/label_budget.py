"""Class log loss by the number of labelled scans that a row's weights learned their classes from."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from gridtrack.evaluation.runs.summary import ClassScores
from gridtrack.reports.run import ReportedRun
from gridtrack.reports.table import HeadlineTable, TableRow

LOSS_CURVES = {"nll": "nll_per_scan", "nll_low": "nll_per_scan_low", "nll_high": "nll_per_scan_high"}
"""Curves of the figure, and their names in summary.json."""


def label_budget_of(runs: Sequence[ReportedRun], table: HeadlineTable, row: TableRow) -> dict[str, Any] | None:
    """What the figure knows of a row: `scans`, its `method` and its `losses` by visibility.

    `method`: the tracker with its options and points, alike in rows that differ in their weights alone. `losses`: the
    curves over the steps, as LOSS_CURVES. None where the row gives no classes, the number of scans is not known, or
    recordings that are pooled differ in it.
    """
    run = next(run for run in runs if row.run in (run.name, ""))
    names = run.recordings if table.pooled else (table.recording,)
    scans = {used.labelled_scans for name in names if (used := run.record.weights.get(f"{row.label}@{name}"))}
    if row.trial.semantics is None or len(scans) != 1 or None in scans:
        return None
    losses = {name: _losses(scores, len(table.horizons_s)) for name, scores in row.trial.semantics.kinds.items()}
    return {"scans": scans.pop(), "method": _method_of(row), "losses": losses}


def _method_of(row: TableRow) -> str:
    entry = row.entry
    options = [f"{name}={value}" for name, value in sorted(entry.options.items())]
    points = ["points=raw"] if entry.points == "raw" else []
    return f"{entry.tracker}:{','.join(options + points)}" if options or points else entry.tracker


def _losses(scores: ClassScores, steps: int) -> dict[str, list[float | None]]:
    found = {name: getattr(scores, curve) for name, curve in LOSS_CURVES.items()}
    return {name: list(curve[:steps]) for name, curve in found.items() if curve is not None}
