"""The times of a row, and whether it keeps up with the stream."""

from __future__ import annotations

from typing import Any

from gridtrack.evaluation.runs.passes import CallTimes, Quantiles
from gridtrack.evaluation.runs.summary import TrialSummary


def times_of(trial: TrialSummary, period_ms: float) -> dict[str, Any] | None:
    """Milliseconds (p50, p95, p99) of an update and of a forecast, and what follows from them; None if not measured."""
    measured = _measured(trial)
    if measured is None:
        return None
    update, predict = measured
    return {
        "update": _of(update),
        "predict": _of(predict),
        "twentieths": {"update": update.twentieths, "predict": predict.twentieths},
        "peak_mib": trial.peak_rss_mb,
        "keeps_up": keeps_up(update, predict, period_ms),
        "highest_hz": float(f"{trial.deadline.highest_rate_hz:.3g}") if trial.deadline else None,
    }


def keeps_up_of(trial: TrialSummary, period_ms: float) -> str:
    """`keeps_up` of a trial; empty where it was not timed."""
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


def _of(times: Quantiles) -> list[float]:
    return [float(f"{ms:.4g}") for ms in (times.p50, times.p95, times.p99)]
