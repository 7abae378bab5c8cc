"""Paired comparison of each tracker with the reference, and the headline tests with Holm's correction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from gridtrack.evaluation.results.summary import HeadlineTest
from gridtrack.evaluation.results.values import rounded, rounded_p
from gridtrack.evaluation.statistics.finished_trial import FinishedTrial
from gridtrack.evaluation.statistics.frame_counts import FrameCounts, common_frames
from gridtrack.evaluation.statistics.jackknife import LEAST_UNITS, PairedDifferences, differences, holm
from gridtrack.evaluation.statistics.score_intervals import Scope, summed_by_unit
from gridtrack.evaluation.statistics.spatial_scores import spatial_differences
from gridtrack.evaluation.statistics.trial_files import HeadlineSums, TrialFiles
from gridtrack.evaluation.statistics.units import UnitRule

ALPHA = 0.05
OTHER_FRAMES = "no frames in common: it was delivered other frames than the reference"
OTHER_RETURNS = (
    "not compared: a row of raw returns and one of the centres of cells receive other frames, so they are not paired"
)


@dataclass(frozen=True, slots=True)
class HeadlineDifference:
    """The differences in one stratum at one horizon, by score (fields of HeadlineTest), not rounded."""

    stratum: str
    horizon_s: float
    step: int
    scores: Mapping[str, PairedDifferences]

    @property
    def f1_p(self) -> float:
        """The uncorrected p-value of F1."""
        return float(self.scores["f1"].p)

    def test(self, p_holm: float) -> HeadlineTest:
        """The test for the summary, with its corrected p-value: better or worse only where it is significant."""
        ends = {
            key: value
            for score, found in self.scores.items()
            for key, value in (
                (score, rounded(float(found.value))),
                (f"{score}_low", rounded(float(found.low))),
                (f"{score}_high", rounded(float(found.high))),
                (f"{score}_p", rounded_p(float(found.p))),
            )
        }
        return HeadlineTest(
            stratum=self.stratum,
            horizon_s=round(self.horizon_s, 6),
            step=self.step,
            p_holm=rounded_p(p_holm),
            verdict=verdict_of(float(self.scores["f1"].value), p_holm),
            **ends,
        )


@dataclass(frozen=True, slots=True)
class TrackerComparison:
    """One tracker against the reference over a scope: differences in F1 (S,) per stratum, and those of the headline."""

    tracker: str
    units: int
    frames: int
    why_none: str
    curves: Mapping[str, PairedDifferences] = field(default_factory=dict)
    headline: tuple[HeadlineDifference, ...] = ()


@dataclass(frozen=True, slots=True)
class ComparedRow:
    """The trials of one row on the recordings of a scope, in their order: with their counts."""

    frames: Sequence[FrameCounts]
    trials: Sequence[FinishedTrial]


def compare_with(
    reference: ComparedRow, tracker: ComparedRow, label: str, scope: Scope, rule: UnitRule, files: TrialFiles
) -> TrackerComparison:
    """Differences on the frames that both were scored on, recording by recording. Raises ScoresError."""
    paired = [common_frames(one, other) for one, other in zip(tracker.frames, reference.frames, strict=True)]
    frames = sum(len(one.stamps_ns) for one, _ in paired)
    if not frames:
        return TrackerComparison(label, 0, 0, OTHER_FRAMES)
    sides = [[pair[side] for pair in paired] for side in (0, 1)]
    (own, others), number = summed_by_unit(sides, rule)
    found = differences(own, others, "f1")
    why = rule.too_short(number) if number < LEAST_UNITS else ""
    curves = {name: found.column(k) for k, name in enumerate(scope.strata)}
    headline: tuple[HeadlineDifference, ...] = ()
    if scope.headline:
        chosen = [(step, stratum) for stratum, _, step in scope.headline]
        log_loss = differences(own, others, "nll")
        stamps_ns = [one.stamps_ns for one, _ in paired]
        units = rule.units_of(stamps_ns)
        sums = (files.headline_sums(row.trials, stamps_ns, units, chosen) for row in (tracker, reference))
        beside = _differences_beside_counts(*sums)
        headline = tuple(
            HeadlineDifference(
                stratum,
                horizon_s,
                step,
                {
                    "f1": curves[stratum].at(step),
                    "nll": log_loss.column(scope.strata.index(stratum)).at(step),
                    **{score: found.at(i) for score, found in beside.items()},
                },
            )
            for i, (stratum, horizon_s, step) in enumerate(scope.headline)
        )
    return TrackerComparison(label, number, frames, why, curves, headline)


def _differences_beside_counts(own: HeadlineSums, reference: HeadlineSums) -> dict[str, PairedDifferences]:
    """Differences (N,) of the scores that do not follow from the counts of frames.

    PR-AUC, and those that forgive a few cells where both rows have their sums.
    """
    return {"pr_auc": own.pr_auc.less(reference.pr_auc), **spatial_differences(own.spatial, reference.spatial)}


def headline_tests(comparisons: Sequence[TrackerComparison]) -> list[tuple[HeadlineTest, ...]]:
    """The headline tests of each comparison, with Holm's correction over all of them as one family."""
    adjusted = iter(holm(np.array([test.f1_p for one in comparisons for test in one.headline])).tolist())
    return [tuple(test.test(next(adjusted)) for test in one.headline) for one in comparisons]


def verdict_of(difference: float, p: float) -> str:
    """What a difference in F1 with its corrected p-value says."""
    if np.isnan(p):
        return "not tested"
    if p >= ALPHA:
        return "no difference shown"
    return "better" if difference > 0 else "worse"
