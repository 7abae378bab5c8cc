"""Measurements beside the scores, for the page's data: times of the calls, and F1 under other conditions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from gridtrack.evaluation.runs.passes import CallTimes, Quantiles
from gridtrack.evaluation.runs.result_files import Curves
from gridtrack.evaluation.runs.summary import TrialSummary
from gridtrack.evaluation.scores.f1 import F1
from gridtrack.reports.table import MAIN_STRATUM, HeadlineTable

CONDITION_STRATA = (MAIN_STRATUM, "dynamic", "visible")
RATE = "rate"
"""The condition in which frames arrive at a multiple of the stream's rate, on a simulated clock."""
DEGRADATION_TEXTS = {
    "beam_dropout": ("beams without a return", ""),
    "range_noise": ("range noise", " m"),
    "frame_drop": ("frames dropped", ""),
    "pose_jitter": ("pose jitter", " m"),
}
"""The name of each kind of degradation on the page, and its unit."""


def times_of(trial: TrialSummary, period_ms: float) -> dict[str, Any] | None:
    """Milliseconds (p50, p95, p99) of an update and of a forecast, and whether they keep up; None if not measured."""
    measured = _measured(trial)
    if measured is None:
        return None
    update, predict = measured
    return {
        "update": _quantiles(update),
        "predict": _quantiles(predict),
        "twentieths": {"update": update.twentieths, "predict": predict.twentieths},
        "peak_mib": trial.peak_rss_mb,
        "keeps_up": keeps_up(update, predict, period_ms),
        "highest_hz": float(f"{trial.deadline.highest_rate_hz:.3g}") if trial.deadline else None,
    }


def keeps_up_of(trial: TrialSummary, period_ms: float) -> str:
    """`keeps_up` of a trial; empty if it was not timed."""
    measured = _measured(trial)
    return "" if measured is None else keeps_up(*measured, period_ms)


def keeps_up(update: Quantiles, predict: Quantiles, period_ms: float) -> str:
    """Whether a tracker keeps up with the stream: the 99th percentiles of its times against the period, all in ms."""
    if update.p99 + predict.p99 <= period_ms:
        return "yes"
    return "updates only" if update.p99 <= period_ms else "no"


def _measured(trial: TrialSummary) -> tuple[CallTimes, CallTimes] | None:
    if trial.latency_ms:
        return trial.latency_ms.update, trial.latency_ms.predict
    return (trial.deadline.update_ms, trial.deadline.predict_ms) if trial.deadline else None


def _quantiles(times: Quantiles) -> list[float]:
    return [float(f"{ms:.4g}") for ms in (times.p50, times.p95, times.p99)]


def condition_texts(tables: Sequence[HeadlineTable]) -> dict[str, dict[str, str]]:
    """Name, unit and meaning of each condition with scores."""
    trials = [row.trial for table in tables for row in table.rows]
    kinds = dict.fromkeys(kind for trial in trials if trial.robustness for kind in trial.robustness.kinds)
    texts = {kind: DEGRADATION_TEXTS.get(kind, (kind, "")) for kind in kinds}
    meaning = "input degraded, scored against undegraded frames"
    found = {kind: {"name": name, "unit": unit, "meaning": meaning} for kind, (name, unit) in texts.items()}
    if any(trial.deadline for trial in trials):
        late = "a frame without a forecast in time is not scored; ×2 is twice the rate of frames"
        found = {RATE: {"name": "rate of frames", "unit": "", "meaning": late}} | found
    return found


def conditions_of(trial: TrialSummary, step: int) -> dict[str, dict[str, Any]]:
    """For each condition its `values`, the F1 at each value by stratum at `step`, and notes of missed frames."""
    found: dict[str, dict[str, Any]] = {}
    if trial.deadline:
        own = {name: trial.estimate(name, F1.name, F1.lead.name) for name in CONDITION_STRATA}
        untimed = {name: estimate.value for name, estimate in own.items() if estimate is not None}
        missed = [f"{100 * at.missed / max(at.frames, 1):.0f} % of frames missed" for at in trial.deadline.rates]
        found[RATE] = {
            "values": [0.0, *(at.rate for at in trial.deadline.rates)],
            "f1": _at_step([untimed, *(at.f1 for at in trial.deadline.rates)], step),
            "notes": ["no deadline", *missed],
        }
    for kind, points in trial.robustness.kinds.items() if trial.robustness else ():
        found[kind] = {"values": [p.value for p in points], "f1": _at_step([p.f1 for p in points], step)}
    return found


def _at_step(curves: list[Curves], step: int) -> dict[str, list[float | None]]:
    return {
        stratum: [curve[stratum][step] if stratum in curve else None for curve in curves]
        for stratum in CONDITION_STRATA
        if any(stratum in curve for curve in curves)
    }
