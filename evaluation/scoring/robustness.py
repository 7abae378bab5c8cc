"""Robustness in the summary: F1 over the strength of degradation, and trials with mismatched degraded frames."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

from gridtrack.evaluation.scoring.record import Robustness, TrialRecord


def robustness_summary(robustness: Robustness, strata: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """F1 of each kind of degradation by strength; strength 0 is the trial's own score, from `strata` of the summary."""
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


def mismatched_degradations(records: Iterable[tuple[str, TrialRecord]]) -> list[str]:
    """Labels of the trials of one recording whose degraded frames differ from those of most trials.

    `records` are pairs of the requested returns and the record; trials are compared at equal returns and strength.
    """
    deliveries = [
        (record.label, (points, kind, point.value), point.delivered)
        for points, record in records
        if record.robustness
        for kind, curve in record.robustness.kinds.items()
        for point in curve
    ]
    digests: dict[tuple[str, str, float], Counter[str]] = {}
    for _, condition, digest in deliveries:
        digests.setdefault(condition, Counter())[digest] += 1
    mismatched = (label for label, condition, digest in deliveries if digest != digests[condition].most_common(1)[0][0])
    return list(dict.fromkeys(mismatched))
