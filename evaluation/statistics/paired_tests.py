"""Paired comparison of each tracker with the reference, and the headline tests with Holm's correction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from gridtrack.evaluation.results.summary import HeadlineTest
from gridtrack.evaluation.results.values import rounded, rounded_p
from gridtrack.evaluation.statistics.frame_counts import FrameCounts, common_frames
from gridtrack.evaluation.statistics.jackknife import LEAST_UNITS, PairedDifferences, differences, holm
from gridtrack.evaluation.statistics.score_intervals import Scope, summed_by_unit
from gridtrack.evaluation.statistics.units import UnitRule

ALPHA = 0.05
OTHER_FRAMES = "no frames in common: it was delivered other frames than the reference"
OTHER_RETURNS = (
    "not compared: a row of raw returns and one of the centres of cells receive other frames, so they are not paired"
)


@dataclass(frozen=True, slots=True)
class HeadlineDifference:
    """The difference in F1 in one stratum at one horizon, its interval and its p-value, not rounded."""

    stratum: str
    horizon_s: float
    step: int
    f1: float
    f1_low: float
    f1_high: float
    f1_p: float

    def test(self, p_holm: float) -> HeadlineTest:
        """The test for the summary, with its corrected p-value: better or worse only where it is significant."""
        return HeadlineTest(
            stratum=self.stratum,
            horizon_s=round(self.horizon_s, 6),
            step=self.step,
            f1=rounded(self.f1),
            f1_low=rounded(self.f1_low),
            f1_high=rounded(self.f1_high),
            f1_p=rounded_p(self.f1_p),
            p_holm=rounded_p(p_holm),
            verdict=_verdict(self.f1, p_holm),
        )


@dataclass(frozen=True, slots=True)
class TrackerComparison:
    """One tracker against the reference over a scope: per stratum the differences in F1 (S,), and the headline's."""

    tracker: str
    units: int
    frames: int
    why_none: str
    curves: Mapping[str, PairedDifferences] = field(default_factory=dict)
    headline: tuple[HeadlineDifference, ...] = ()


def compare_with(
    reference: Sequence[FrameCounts], tracker: Sequence[FrameCounts], label: str, scope: Scope, rule: UnitRule
) -> TrackerComparison:
    """Differences on the frames that both were scored on, recording by recording in the same order."""
    paired = [common_frames(one, other) for one, other in zip(tracker, reference, strict=True)]
    frames = sum(len(one.stamps_ns) for one, _ in paired)
    if not frames:
        return TrackerComparison(label, 0, 0, OTHER_FRAMES)
    sides = [[pair[side] for pair in paired] for side in (0, 1)]
    (own, others), number = summed_by_unit(sides, rule)
    found = differences(own, others, "f1")
    why = rule.too_short(number) if number < LEAST_UNITS else ""
    curves = {name: found.column(k) for k, name in enumerate(scope.strata)}
    headline = (_at_step(curves[stratum], stratum, horizon_s, step) for stratum, horizon_s, step in scope.headline)
    return TrackerComparison(label, number, frames, why, curves, tuple(headline))


def _at_step(curve: PairedDifferences, stratum: str, horizon_s: float, step: int) -> HeadlineDifference:
    ends = (float(values[step]) for values in (curve.value, curve.low, curve.high, curve.p))
    return HeadlineDifference(stratum, horizon_s, step, *ends)


def headline_tests(comparisons: Sequence[TrackerComparison]) -> list[tuple[HeadlineTest, ...]]:
    """The headline tests of each comparison, with Holm's correction over all of them as one family."""
    adjusted = iter(holm(np.array([test.f1_p for one in comparisons for test in one.headline])).tolist())
    return [tuple(test.test(next(adjusted)) for test in one.headline) for one in comparisons]


def _verdict(difference: float, p: float) -> str:
    if np.isnan(p):
        return "not tested"
    if p >= ALPHA:
        return "no difference shown"
    return "better" if difference > 0 else "worse"
