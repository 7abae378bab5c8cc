"""Intervals of the scores of one recording, or of several pooled, from the counts of their statistical units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.results.recording import RecordingDescription
from gridtrack.evaluation.results.values import rounded_curve
from gridtrack.evaluation.statistics.frame_counts import FrameCounts
from gridtrack.evaluation.statistics.jackknife import COUNTS, LEAST_UNITS, RATIO_SCORES, TOO_SHORT, interval
from gridtrack.evaluation.statistics.units import BLOCK_TIMES, autocorrelation_time, residuals, sum_by_unit, units_of

HEADLINE_STRATA, HEADLINE_HORIZONS_S = ("dynamic", "visible"), (0.5, 1.0, 2.5)
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
        """Stratum, horizon and step of each comparison of the family, as far as the run forecasts."""
        period_s = self.horizons_s[1] - self.horizons_s[0]
        steps = [(h, round(h / period_s)) for h in HEADLINE_HORIZONS_S]
        reached = [(h, step) for h, step in steps if 0 < step < len(self.horizons_s)]
        return [(name, h, step) for name in HEADLINE_STRATA if name in self.strata for h, step in reached]

    def block_s(self, trials: Sequence[Sequence[FrameCounts]]) -> float:
        """Shortest block, seconds: a cycle, and BLOCK_TIMES autocorrelation times of the headline scores of any trial.

        `trials` has the frames of each trial on each recording. 0 without a cycle and without a trial of two frames.
        """
        longest = [self.cycle_s or 0.0]
        for recordings in trials:
            for frames in recordings:
                spacing_s = float(np.median(np.diff(frames.stamps_ns))) / 1e9 if len(frames.stamps_ns) > 1 else 0.0
                longest.append(BLOCK_TIMES * spacing_s * autocorrelation_time(self._headline_residuals(frames)))
        return max(longest)

    def _headline_residuals(self, frames: FrameCounts) -> NDArray[np.float64]:
        """Residuals (F, N) of F1 at the N headline strata and steps, from which the autocorrelation is computed."""
        part, whole = (np.array([side.get(name, 0.0) for name in COUNTS]) for side in RATIO_SCORES["f1"])
        marked = self.headline or [(self.strata[0], 0.0, len(self.horizons_s) - 1)]
        series = [frames.counts[:, step, self.strata.index(name)] for name, _, step in marked]
        return residuals(*(np.stack([s @ weights for s in series], axis=1) for weights in (part, whole)))


def intervals(
    recordings: Sequence[FrameCounts], strata: Sequence[str], block_s: float
) -> dict[str, dict[str, tuple[float | None, ...] | str | None]]:
    """Per stratum `f1_low`, `f1_high` and so on, one value per step; `interval` has the reason where there are none."""
    (counts,), number = summed_by_unit([recordings], block_s)
    if number < LEAST_UNITS:
        nothing = {f"{score}_{end}": None for score in RATIO_SCORES for end in ("low", "high")}
        return {name: {**nothing, "interval": too_short(number, len(recordings), block_s)} for name in strata}
    found = {score: interval(counts, score) for score in RATIO_SCORES}
    return {
        name: {
            **{f"{score}_low": rounded_curve(low[:, k]) for score, (low, _) in found.items()},
            **{f"{score}_high": rounded_curve(high[:, k]) for score, (_, high) in found.items()},
            "interval": "",
        }
        for k, name in enumerate(strata)
    }


def summed_by_unit(sides: Sequence[Sequence[FrameCounts]], block_s: float) -> tuple[list[NDArray[np.float64]], int]:
    """Counts (U, S, K, C) of the units for each side, and the number of units; the sides have the same frames."""
    units = units_of([frames.stamps_ns for frames in sides[0]], block_s)
    summed = [
        np.concatenate([sum_by_unit(f.counts, unit) for f, unit in zip(side, units, strict=True) if len(unit)])
        for side in sides
    ]
    return summed, len(summed[0])


def too_short(units: int, recordings: int, block_s: float) -> str:
    """The reason why there is no interval, for fewer than LEAST_UNITS units."""
    if units == recordings > 1:
        return f"{TOO_SHORT}: {units} recordings, and {LEAST_UNITS} units are needed"
    blocks = f"blocks of at least {block_s:.3g} s" if block_s else "a single forecast"
    return f"{TOO_SHORT}: {units} unit{'s' * (units != 1)}, {blocks}, and {LEAST_UNITS} are needed"


def common_strata(strata: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """The strata that every recording has, in the order of the first."""
    return tuple(name for name in strata[0] if all(name in others for others in strata))


def poolable(recordings: Mapping[str, RecordingDescription]) -> bool:
    """Whether steps and cells of all recordings are the same, so that their counts may be added."""
    sampled = [(recording.horizons_s, recording.grid) for recording in recordings.values()]
    return all(one == other for one, other in pairwise(sampled))
