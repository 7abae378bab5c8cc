"""Paired differences of ratios that are not in the counts of occupancy: of classes, and of occluded cells."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from gridtrack.evaluation.results.summary import ALL_RECORDINGS
from gridtrack.evaluation.statistics.finished_trial import FinishedTrial
from gridtrack.evaluation.statistics.frame_counts import FrameCounts, common_frames
from gridtrack.evaluation.statistics.jackknife import LEAST_UNITS, Floats, PairedDifferences, ratio_differences
from gridtrack.evaluation.statistics.paired_tests import OTHER_FRAMES, OTHER_RETURNS
from gridtrack.evaluation.statistics.run_statistics import RunStatistics
from gridtrack.evaluation.statistics.score_intervals import summed_by_unit


@dataclass(frozen=True, slots=True)
class PairedRatios:
    """`described`: fields of every difference in summary.json. `found` (S, K): None without a common frame."""

    described: dict[str, Any]
    found: PairedDifferences | None


def paired_ratios(
    statistics: RunStatistics,
    own: Sequence[FinishedTrial],
    others: Sequence[FinishedTrial],
    names: Sequence[str],
    counts_of: Callable[[FinishedTrial], FrameCounts],
) -> PairedRatios:
    """Ratios of the trials `own` less those of `others`, over the frames that both have on the recordings `names`.

    `counts_of` gives counts (F, S, K, C) of a trial: numerator and denominator of K ratios, and with a third column how
    much there was to find. Where there was nothing in any unit, the ratio is undefined.
    """
    pairs = [common_frames(*map(counts_of, pair)) for pair in zip(own, others, strict=True)]
    described: dict[str, Any] = {
        "recordings": ALL_RECORDINGS if len(names) > 1 else names[0],
        "tracker": own[0].record.label,
        "reference": others[0].record.label,
        "frames": sum(len(one.stamps_ns) for one, _ in pairs),
    }
    if not described["frames"]:
        why = OTHER_FRAMES if own[0].points == others[0].points else OTHER_RETURNS
        return PairedRatios({**described, "interval": why}, None)
    rule = statistics.unit_rule(names)
    sides, units = summed_by_unit([[pair[side] for pair in pairs] for side in (0, 1)], rule)
    mine, theirs = map(_sums_of, sides)
    why = rule.too_short(units) if units < LEAST_UNITS else ""
    return PairedRatios({**described, "units": units, "interval": why}, ratio_differences(mine, theirs))


def _sums_of(counts: Floats) -> tuple[Floats, Floats]:
    """Numerator and denominator (U, S, K) of counts (U, S, K, C); a denominator of 0 where the ratio is undefined."""
    return counts[..., 0], counts[..., 1] * (counts[..., -1].sum(axis=0) > 0)
