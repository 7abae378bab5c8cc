"""Scores on degraded frames for the summary, and whether every tracker received the same degraded frames."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping

from gridtrack.evaluation.results.passes import AtStrength, Robustness
from gridtrack.evaluation.results.trial_record import TrialRecord
from gridtrack.evaluation.results.trial_summary import StratumScores


def with_undegraded(robustness: Robustness, strata: Mapping[str, StratumScores]) -> Robustness:
    """F1 of each kind by its strength; at strength 0 it is the trial's own, of `strata`."""
    undegraded = AtStrength(
        strength=0.0, value=0.0, delivered="", f1={name: scores.f1 for name, scores in strata.items()}
    )
    kinds = {kind: (undegraded, *points) for kind, points in robustness.kinds.items()}
    return Robustness(degradation=robustness.degradation, kinds=kinds)


def mismatched_degradations(records: Iterable[tuple[str, TrialRecord]]) -> list[str]:
    """Labels of the trials of one recording that received other degraded frames than most, at equal strength.

    Each record comes with the returns that it requested: trials with other returns are compared among themselves.
    """
    received = [
        (record.label, (points, kind, point.value), point.delivered)
        for points, record in records
        if record.robustness
        for kind, curve in record.robustness.kinds.items()
        for point in curve
    ]
    usual: dict[tuple[str, str, float], Counter[str]] = {}
    for _, condition, digest in received:
        usual.setdefault(condition, Counter())[digest] += 1
    labels = (label for label, condition, digest in received if digest != usual[condition].most_common(1)[0][0])
    return list(dict.fromkeys(labels))
