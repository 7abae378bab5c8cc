"""What degraded frames did to a trial, for the summary: curves over their strength, and whether all saw the same."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

from gridtrack.evaluation.scoring.record import Robustness, TrialRecord


def robustness_summary(robustness: Robustness, strata: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """F1 of each kind by its strength; strength 0 is the trial's own score, as `strata` of the summary has it."""
    undegraded = {
        "strength": 0.0,
        "value": 0.0,
        "delivered": "",
        "f1": {name: scores["f1"] for name, scores in strata.items()},
    }
    kinds = {
        kind: [undegraded, *(point.model_dump(mode="json") for point in points)]
        for kind, points in robustness.kinds.items()
    }
    return {"degradation": robustness.degradation.model_dump(), "kinds": kinds}


def shown_others(records: Iterable[tuple[str, TrialRecord]]) -> list[str]:
    """Labels of the trials of one recording that were shown other degraded frames than most, at equal strength.

    `records` with the returns that each asked for: those that asked for others are compared among themselves.
    """
    shown = [
        (record.label, (points, kind, point.value), point.delivered)
        for points, record in records
        if record.robustness
        for kind, curve in record.robustness.kinds.items()
        for point in curve
    ]
    usual: dict[tuple[str, str, float], Counter[str]] = {}
    for _, condition, digest in shown:
        usual.setdefault(condition, Counter())[digest] += 1
    odd = (label for label, condition, digest in shown if digest != usual[condition].most_common(1)[0][0])
    return list(dict.fromkeys(odd))
