"""What a run's counts allow to say: intervals of scores, and each tracker against the reference, Holm-corrected."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.statistics.frame_counts import FrameCounts, common_frames
from gridtrack.evaluation.statistics.uncertainty import (
    COUNTS,
    LEAST_UNITS,
    SCORES,
    TOO_SHORT,
    differences,
    holm,
    interval,
)
from gridtrack.evaluation.statistics.units import BLOCK_TIMES, autocorrelation_time, residuals, sum_by_unit, units_of

HEADLINE_STRATA, HEADLINE_HORIZONS_S = ("moving", "visible"), (0.5, 1.0, 2.5)
"""The family that Holm's correction is over: F1 in these strata at these horizons, each tracker and the reference."""
ALPHA = 0.05
OTHER_FRAMES = "no frames in common: it was delivered others than the reference"
OTHER_RETURNS = "not compared: a row of raw returns and one of the centres of cells are given other frames, so no pairs"


@dataclass(frozen=True, slots=True)
class Scope:
    """What is told together: one recording, or several pooled.

    `cycle_s` is the longest of their places' cycles, `horizons_s` those of steps 0..steps.
    """

    horizons_s: Sequence[float]
    strata: tuple[str, ...]
    cycle_s: float | None = None

    @property
    def headline(self) -> list[tuple[str, float, int]]:
        """Stratum, horizon and step of each comparison of the family, as far as the run looks ahead."""
        period_s = self.horizons_s[1] - self.horizons_s[0]
        steps = [(h, round(h / period_s)) for h in HEADLINE_HORIZONS_S]
        reached = [(h, step) for h, step in steps if 0 < step < len(self.horizons_s)]
        return [(name, h, step) for name in HEADLINE_STRATA if name in self.strata for h, step in reached]

    def block_s(self, trials: Sequence[Sequence[FrameCounts]]) -> float:
        """How long a block must last, s: longer than the cycle, and than the headline's autocorrelation in any trial.

        `trials` holds the frames of each on every recording; 0 where none has two, as nothing tells how long that is.
        """
        longest = [self.cycle_s or 0.0]
        for recordings in trials:
            for frames in recordings:
                spacing_s = float(np.median(np.diff(frames.stamps_ns))) / 1e9 if len(frames.stamps_ns) > 1 else 0.0
                longest.append(BLOCK_TIMES * spacing_s * autocorrelation_time(self._headline_residuals(frames)))
        return max(longest)

    def _headline_residuals(self, frames: FrameCounts) -> NDArray[np.float64]:
        """Of F1 (F, N), which the autocorrelation is measured on."""
        part, whole = (np.array([side.get(name, 0.0) for name in COUNTS]) for side in SCORES["f1"])
        marked = self.headline or [(self.strata[0], 0.0, len(self.horizons_s) - 1)]
        series = [frames.counts[:, step, self.strata.index(name)] for name, _, step in marked]
        return residuals(*(np.stack([s @ weights for s in series], axis=1) for weights in (part, whole)))


def intervals(
    recordings: Sequence[FrameCounts], strata: Sequence[str], block_s: float
) -> dict[str, dict[str, NDArray[np.float64] | str | None]]:
    """Per stratum `f1_low`, `f1_high` and so on of every score, each (S,); where there is none, `interval` says why."""
    (counts,), number = summed_by_unit([recordings], block_s)
    if number < LEAST_UNITS:
        nothing = {f"{score}_{end}": None for score in SCORES for end in ("low", "high")}
        return {name: {**nothing, "interval": too_short(number, len(recordings), block_s)} for name in strata}
    found = {score: interval(counts, score) for score in SCORES}
    return {
        name: {
            **{f"{score}_low": low[:, k] for score, (low, _) in found.items()},
            **{f"{score}_high": high[:, k] for score, (_, high) in found.items()},
            "interval": "",
        }
        for k, name in enumerate(strata)
    }


@dataclass(slots=True)
class Comparison:
    """One tracker against the reference over a scope: arrays of the differences in F1, and the headline's tests."""

    tracker: str
    units: int
    frames: int
    why_none: str
    curves: dict[str, dict[str, NDArray[np.float64]]] = field(default_factory=dict)
    headline: list[dict[str, Any]] = field(default_factory=list)


def compare_with(
    reference: Sequence[FrameCounts], tracker: Sequence[FrameCounts], label: str, scope: Scope, block_s: float
) -> Comparison:
    """Differences on the frames that both were scored on, recording by recording in the same order."""
    paired = [common_frames(one, other) for one, other in zip(tracker, reference, strict=True)]
    frames = sum(len(one.stamps_ns) for one, _ in paired)
    if not frames:
        return Comparison(label, 0, 0, OTHER_FRAMES)
    sides = [[pair[side] for pair in paired] for side in (0, 1)]
    (own, others), number = summed_by_unit(sides, block_s)
    found = differences(own, others, "f1")
    why = too_short(number, len(paired), block_s) if number < LEAST_UNITS else ""
    arrays = {"f1": found.value, "f1_low": found.low, "f1_high": found.high, "f1_p": found.p}
    comparison = Comparison(label, number, frames, why)
    comparison.curves = {n: {key: a[:, k] for key, a in arrays.items()} for k, n in enumerate(scope.strata)}
    for stratum, horizon_s, step in scope.headline:
        at = {key: float(curve[step]) for key, curve in comparison.curves[stratum].items()}
        comparison.headline.append({"stratum": stratum, "horizon_s": horizon_s, "step": step, **at})
    return comparison


def correct(comparisons: Sequence[Comparison]) -> None:
    """Add Holm's p-value over all headline tests, and the verdict on each: better or worse only where it is shown."""
    tests = [test for comparison in comparisons for test in comparison.headline]
    for test, adjusted in zip(tests, holm(np.array([test["f1_p"] for test in tests])).tolist(), strict=True):
        test["p_holm"] = adjusted
        test["verdict"] = _verdict(test["f1"], adjusted)


def _verdict(difference: float, p: float) -> str:
    if np.isnan(p):
        return "not tested"
    if p >= ALPHA:
        return "no difference shown"
    return "better" if difference > 0 else "worse"


def summed_by_unit(sides: Sequence[Sequence[FrameCounts]], block_s: float) -> tuple[list[NDArray[np.float64]], int]:
    """Counts (U, S, K, C) by unit of each side, whose frames are the same; and how many units there are."""
    units = units_of([frames.stamps_ns for frames in sides[0]], block_s)
    summed = [
        np.concatenate([sum_by_unit(f.counts, unit) for f, unit in zip(side, units, strict=True) if len(unit)])
        for side in sides
    ]
    return summed, len(summed[0])


def too_short(units: int, recordings: int, block_s: float) -> str:
    """Why no interval is drawn from so many units."""
    if units == recordings > 1:
        return f"{TOO_SHORT}: {units} recordings, and {LEAST_UNITS} units are needed"
    blocks = f"blocks of at least {block_s:.3g} s" if block_s else "a single forecast"
    return f"{TOO_SHORT}: {units} unit{'s' * (units != 1)}, {blocks}, and {LEAST_UNITS} are needed"


def common_strata(strata: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Those that every recording has, in the order of the first."""
    return tuple(name for name in strata[0] if all(name in others for others in strata))


def poolable(recordings: Mapping[str, Mapping[str, Any]]) -> bool:
    """Whether steps and cells of all recordings are the same, so that their counts may be added."""
    kinds = [(list(recording["horizons_s"]), recording.get("grid")) for recording in recordings.values()]
    return all(one == other for one, other in pairwise(kinds))
