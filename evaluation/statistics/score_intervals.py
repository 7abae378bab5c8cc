"""Intervals of the scores of one recording, or of several pooled, from the counts of their statistical units."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import nearest_step
from gridtrack.evaluation.results.values import rounded_curve
from gridtrack.evaluation.scoring.histograms import UnitHistograms
from gridtrack.evaluation.statistics.finished_trial import FinishedTrial
from gridtrack.evaluation.statistics.frame_counts import FrameCounts
from gridtrack.evaluation.statistics.jackknife import COUNTS, LEAST_UNITS, RATIO_SCORES, interval, pooled
from gridtrack.evaluation.statistics.pr_auc import pr_auc_of_units
from gridtrack.evaluation.statistics.units import (
    UnitRule,
    autocorrelation_time,
    residuals,
    shortest_block_s,
    sum_by_unit,
)

HEADLINE_STRATA, HEADLINE_HORIZONS_S = ("in-motion", "dynamic", "visible"), (0.5, 1.0, 2.5)
"""Strata and horizons of the headline tests: the family of Holm's correction is F1 in these, for each tracker."""


@dataclass(frozen=True, slots=True)
class Scope:
    """The recordings that are scored together: one, or several pooled.

    `cycle_s` is the longest cycle of their sites, `horizons_s` are those of steps 0..steps.
    """

    horizons_s: Sequence[float]
    strata: tuple[str, ...]
    cycle_s: float | None = None

    @property
    def headline(self) -> list[tuple[str, float, int]]:
        """Stratum, horizon of the step, and step of each comparison of the family, as far as the run forecasts.

        The steps are those nearest to HEADLINE_HORIZONS_S, each of them once.
        """
        period_s = self.horizons_s[1] - self.horizons_s[0]
        steps = dict.fromkeys(nearest_step(h, period_s) for h in HEADLINE_HORIZONS_S)
        reached = [(float(self.horizons_s[step]), step) for step in steps if 0 < step < len(self.horizons_s)]
        return [(name, h, step) for name in HEADLINE_STRATA if name in self.strata for h, step in reached]

    def block_s(self, trials: Sequence[FrameCounts]) -> float:
        """Shortest block, seconds, for the longest autocorrelation time of F1 of any of `trials`, in any stratum."""
        return shortest_block_s(max(map(self._correlated_s, trials), default=0.0), self.cycle_s)

    def _correlated_s(self, frames: FrameCounts) -> float:
        """The autocorrelation time, seconds, of F1 in every stratum at the headline's horizons."""
        if len(frames.stamps_ns) < 2:
            return 0.0
        spacing_s = float(np.median(np.diff(frames.stamps_ns))) / 1e9
        part, whole = (np.array([side.get(name, 0.0) for name in COUNTS]) for side in RATIO_SCORES["f1"])
        steps = sorted({step for _, _, step in self.headline}) or [len(self.horizons_s) - 1]
        counts = frames.counts[:, steps].astype(np.float64)
        return spacing_s * autocorrelation_time(residuals(counts @ part, counts @ whole))


INTERVAL_SCORES = (*RATIO_SCORES, "pr_auc")
"""The scores that have intervals."""
ONE_UNIT = "no interval of PR-AUC: one unit holds all occupied cells of a stratum"
"""Why PR-AUC has no interval at some step of a stratum, where the other scores may have theirs."""
AGREEING = "no interval at some horizons: the few units that have occupied cells agree exactly"
"""Why F1 has no interval at some step of a stratum, which may have one at others."""


def intervals(
    recordings: Sequence[FrameCounts],
    trials: Sequence[FinishedTrial],
    histograms: Iterable[UnitHistograms],
    strata: Sequence[str],
    rule: UnitRule,
) -> dict[str, dict[str, tuple[float | None, ...] | str | None]]:
    """Per stratum `f1_low`, `f1_high` and so on, one value per step; `interval` has the reason where there are none, at
    some steps or at all of them, or none of PR-AUC.

    `recordings` are the counts of `trials`, at the steps of each, and `histograms` those of their units.
    """
    (counts,), number = summed_by_unit([recordings], rule)
    if number < LEAST_UNITS:
        nothing = {f"{score}_{end}": None for score in INTERVAL_SCORES for end in ("low", "high")}
        return {name: {**nothing, "interval": rule.too_short(number)} for name in strata}
    found = {score: interval(counts, score) for score in RATIO_SCORES}
    agreeing = np.isnan(found["f1"][0]) & ~np.isnan(pooled(counts, "f1"))
    stamps = [frames.stamps_ns for frames in recordings]
    chosen = list(product(range(counts.shape[1]), strata))
    pr_auc = pr_auc_of_units(trials, histograms, rule.units_of(stamps), chosen)
    shape = counts.shape[1], len(strata)
    low, high = (end.reshape(shape) for end in pr_auc.interval())
    alone = pr_auc.rests_on_one_unit.reshape(shape)
    found["pr_auc"] = low, high
    return {
        name: {
            **{f"{score}_low": rounded_curve(low[:, k]) for score, (low, _) in found.items()},
            **{f"{score}_high": rounded_curve(high[:, k]) for score, (_, high) in found.items()},
            "interval": AGREEING if agreeing[:, k].any() else ONE_UNIT if alone[:, k].any() else "",
        }
        for k, name in enumerate(strata)
    }


def summed_by_unit(sides: Sequence[Sequence[FrameCounts]], rule: UnitRule) -> tuple[list[NDArray[np.float64]], int]:
    """Counts (U, S, K, C) of the units for each side, and the number of units; the sides have the same frames."""
    units = rule.units_of([frames.stamps_ns for frames in sides[0]])
    summed = [sum_by_unit([frames.counts for frames in side], units) for side in sides]
    return summed, len(summed[0])


def common_strata(strata: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """The strata that every recording has, in the order of the first."""
    return tuple(name for name in strata[0] if all(name in others for others in strata))
