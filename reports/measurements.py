"""Measurements beside the scores, for the page's data: times of the calls, and scores under other conditions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from gridtrack.evaluation.runs.passes import CallTimes, Quantiles
from gridtrack.evaluation.runs.result_files import Curves
from gridtrack.evaluation.runs.summary import TrialSummary
from gridtrack.reports.table import MAIN_STRATUM, HeadlineTable

CONDITION_STRATA = (MAIN_STRATUM, "dynamic", "visible")
RATE = "rate"
"""The condition in which frames arrive at a multiple of the stream's rate, on a simulated clock."""
DEGRADATION_TEXTS = {
    "beam_dropout": ("beams without a return", ""),
    "sector_dropout": ("sectors without a return", ""),
    "range_noise": ("range noise", " m"),
    "frame_drop": ("frames dropped", ""),
    "pose_jitter": ("pose jitter", " m"),
}
"""The name of each kind of degradation on the page, and its unit."""


def times_of(trial: TrialSummary, period_ms: float) -> dict[str, Any] | None:
    """Milliseconds (p50, p95, p99) of an update and of a forecast, on which device, and whether they keep up; None if
    not measured."""
    measured = _measured(trial)
    if measured is None:
        return None
    update, predict, device = measured
    return {
        "update": _quantiles(update),
        "predict": _quantiles(predict),
        "twentieths": {"update": update.twentieths, "predict": predict.twentieths},
        "peak_mib": trial.peak_rss_mb,
        "keeps_up": keeps_up(update, predict, period_ms),
        "device": device,
        "highest_hz": float(f"{trial.deadline.highest_rate_hz:.3g}") if trial.deadline else None,
    }


def keeps_up_of(trial: TrialSummary, period_ms: float) -> str:
    """`keeps_up` of a trial; empty if it was not timed."""
    measured = _measured(trial)
    return "" if measured is None else keeps_up(measured[0], measured[1], period_ms)


def keeps_up(update: Quantiles, predict: Quantiles, period_ms: float) -> str:
    """Whether a tracker keeps up with the stream: the 99th percentiles of its times against the period, all in ms."""
    if update.p99 + predict.p99 <= period_ms:
        return "yes"
    return "updates only" if update.p99 <= period_ms else "no"


def _measured(trial: TrialSummary) -> tuple[CallTimes, CallTimes, str] | None:
    """Times of updates and of forecasts, and the device that they were measured on; None if not measured."""
    if latency := trial.latency_ms:
        return latency.update, latency.predict, latency.device
    deadline = trial.deadline
    return (deadline.update_ms, deadline.predict_ms, deadline.device) if deadline else None


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
        late = "every cell is free until the first forecast in time; ×2 is twice the rate of frames"
        found = {RATE: {"name": "rate of frames", "unit": "", "meaning": late}} | found
    return found


def conditions_of(trial: TrialSummary, leads: Mapping[str, str], step: int) -> dict[str, dict[str, Any]]:
    """For each condition its `values`, the `scores` at each value by score and stratum, and notes of missed frames.

    `leads`: the leading output of each score. Scores are those at `step`.
    """
    found: dict[str, dict[str, Any]] = {}
    if trial.deadline:
        missed = [f"{100 * at.missed / max(at.frames, 1):.0f} % of frames missed" for at in trial.deadline.rates]
        found[RATE] = {
            "values": [0.0, *(at.rate for at in trial.deadline.rates)],
            "scores": _at_step([trial.leading(leads), *(at.scores for at in trial.deadline.rates)], step),
            "notes": ["no deadline", *missed],
        }
    for kind, points in trial.robustness.kinds.items() if trial.robustness else ():
        found[kind] = {"values": [p.value for p in points], "scores": _at_step([p.scores for p in points], step)}
    return found


def _at_step(points: Sequence[Mapping[str, Curves]], step: int) -> dict[str, dict[str, list[float | None]]]:
    """The values (P,) at `step` of P `points`, by score and stratum: of the scores that the last point has."""
    by_score = {score: [point.get(score, {}) for point in points] for score in points[-1]}
    return {
        score: {
            stratum: [curves[stratum][step] if stratum in curves else None for curves in own]
            for stratum in CONDITION_STRATA
            if any(stratum in curves for curves in own)
        }
        for score, own in by_score.items()
    }
