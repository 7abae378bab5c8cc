"""Scores of a trial, or of several pooled, per stratum and step, from their counts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.results.trial_record import TrialRecord
from gridtrack.evaluation.results.trial_summary import StratumScores
from gridtrack.evaluation.results.values import rounded_curve
from gridtrack.evaluation.scoring import metrics
from gridtrack.evaluation.scoring.counting import Tally
from gridtrack.evaluation.scoring.thresholds import bins_of, half


@dataclass(frozen=True, slots=True)
class CountedTrial:
    """A trial with its counts in its strata at `steps`, S of them, of its forecasts.

    `label_free`: TP, FP, FN, TN (S, K, 4) at the thresholds that need no labels.
    """

    record: TrialRecord
    steps: list[int]
    tally: Tally
    label_free: NDArray[np.int64]

    def thresholds(self, strata: Sequence[str]) -> NDArray[np.float64]:
        """Thresholds (S, K) as probabilities."""
        return np.array([self.record.thresholds.values[name] for name in strata]).T[self.steps]


def stratum_scores(
    trials: Iterable[CountedTrial], steps: int, strata: tuple[str, ...], described: Mapping[str, Mapping[str, Any]]
) -> dict[str, StratumScores]:
    """Scores of the summed counts of `trials`, of S `steps` each, at its own thresholds; one that differs is None.

    `described` holds, by stratum, the fields of StratumScores that `score_intervals.intervals`,
    `spatial_scores.spatial_scores` and `optional_scores.optional_scores` give.
    """
    curves = _curves_of(trials, steps, strata)
    return {
        name: StratumScores(
            **{score: rounded_curve(values[:, k]) for score, values in curves.items()}, **described[name]
        )
        for k, name in enumerate(strata)
    }


def _curves_of(trials: Iterable[CountedTrial], steps: int, strata: tuple[str, ...]) -> dict[str, NDArray[np.float64]]:
    """Every score (S, K) by its field in StratumScores."""
    together = Tally.empty(steps - 1, strata)
    at_threshold, at_visible, label_free = np.zeros((3, steps, len(strata), 4), np.int64)
    chosen = []
    for counted in trials:
        tally = counted.tally.of(strata)
        label_free += counted.label_free[:, [counted.tally.strata.index(name) for name in strata]]
        together.add(tally)
        bins = bins_of(counted.thresholds(strata))
        at_threshold += tally.confusion(bins)
        at_visible += tally.confusion(np.broadcast_to(bins_of(counted.thresholds(("visible",))), bins.shape))
        chosen.append(counted.thresholds(strata))
    parts = metrics.brier_decomposition(together)
    return {
        "f1": metrics.f1_score(at_threshold),
        "precision": metrics.precision(at_threshold),
        "recall": metrics.recall(at_threshold),
        "pr_auc": metrics.average_precision(together),
        "brier": metrics.brier_score(together),
        "brier_reliability": parts.reliability,
        "brier_resolution": parts.resolution,
        "brier_uncertainty": parts.uncertainty,
        "nll": metrics.log_loss(together),
        "ece": metrics.calibration_error(together),
        "ece_above_1_percent": metrics.calibration_error(together, metrics.THOUGHT_OCCUPIED),
        "threshold": np.where(np.ptp(chosen, axis=0) == 0, chosen[0], np.nan),
        "f1_at_visible": metrics.f1_score(at_visible),
        "f1_label_free": metrics.f1_score(label_free),
        "f1_at_half": metrics.f1_score(together.confusion(half(steps - 1, strata).bins)),
    }
