"""F1 under a deadline and on degraded input, for the page's data."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from gridtrack.evaluation.runs.result_files import Curves
from gridtrack.evaluation.runs.summary import TrialSummary
from gridtrack.reports.table import MAIN_STRATUM, HeadlineTable, TableColumn

CONDITION_STRATA = (MAIN_STRATUM, "dynamic", "visible")
RATE = "rate"
"""The condition of frames that arrive at a multiple of the stream's rate, on a simulated clock."""
DEGRADATION_TEXTS = {
    "beam_dropout": ("beams without a return", ""),
    "range_noise": ("range noise", " m"),
    "frame_drop": ("frames dropped", ""),
    "pose_jitter": ("pose jitter", " m"),
}
"""The name of each kind of degradation on the page, and its unit of measurement."""


def condition_texts(tables: Sequence[HeadlineTable]) -> dict[str, dict[str, str]]:
    """Name, unit and meaning of each condition that any row was scored under."""
    trials = [row.trial for table in tables for row in table.rows]
    kinds = dict.fromkeys(kind for trial in trials if trial.robustness for kind in trial.robustness.kinds)
    texts = {kind: DEGRADATION_TEXTS.get(kind, (kind, "")) for kind in kinds}
    meaning = "input degraded, scored against undegraded frames"
    found = {kind: {"name": name, "unit": unit, "meaning": meaning} for kind, (name, unit) in texts.items()}
    if any(trial.deadline for trial in trials):
        late = "what is not forecast in time is not scored; ×2 is twice the rate of frames"
        found = {RATE: {"name": "rate of frames", "unit": "", "meaning": late}} | found
    return found


def conditions_of(trial: TrialSummary, column: TableColumn) -> dict[str, dict[str, Any]]:
    """By condition its `values`, the F1 at each by stratum at the step of `column`, and notes of what was missed."""
    found: dict[str, dict[str, Any]] = {}
    if trial.deadline:
        untimed = {name: scores.f1 for name, scores in trial.strata.items()}
        missed = [f"{100 * at.missed / max(at.frames, 1):.0f} % of frames missed" for at in trial.deadline.rates]
        found[RATE] = {
            "values": [0.0, *(at.rate for at in trial.deadline.rates)],
            "f1": _f1_of([untimed, *(at.f1 for at in trial.deadline.rates)], column.step),
            "notes": ["no deadline", *missed],
        }
    for kind, points in trial.robustness.kinds.items() if trial.robustness else ():
        found[kind] = {"values": [p.value for p in points], "f1": _f1_of([p.f1 for p in points], column.step)}
    return found


def _f1_of(curves: list[Curves], step: int) -> dict[str, list[float | None]]:
    return {
        stratum: [curve[stratum][step] if stratum in curve else None for curve in curves]
        for stratum in CONDITION_STRATA
        if any(stratum in curve for curve in curves)
    }
