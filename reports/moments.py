"""Kept forecasts for the page: their order, and their packing.

A packed moment is planes of M x M bytes, rows from the bottom up, deflated, as base64: the input (0 not visible, 1
free, 2 occupied); for each horizon the state of each cell (`evaluation/referee/targets.py`), plus IN_MOTION for the
visible cells of that stratum; and for each tracker and horizon the forecast: its level of PACKED_LEVELS, plus CALLED
from the tracker's threshold on. A kept probability is exact to 0.5 / 255, so CALLED may be wrong for cells that are
nearer to the threshold.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.referee.samples import Sample
from gridtrack.evaluation.runs.sums import ScoresError, TrialSums
from gridtrack.evaluation.scores.f1 import COUNTS, F1
from gridtrack.reports.pictures import SHADES, palette
from gridtrack.reports.run import ReportError
from gridtrack.reports.table import MAIN_STRATUM

FEW_CELLS = 5
"""Moments with fewer occupied cells come last: F1 of one cell is 0 or 1 by chance."""
LEAST_DIFFERENCE = 0.01
"""Moments with a smaller difference of the trackers' F1 are not `different`."""
PACKED_LEVELS = 32
"""Levels of probability: 5 bits."""
CALLED, IN_MOTION = 32, 8
DEFLATE_LEVEL = 7
"""Planes take 8 % more than at level 8, which takes three times as long."""


@dataclass(frozen=True)
class FrameScore:
    """The counts of one tracker on cells in motion, at one scored frame and step."""

    tp: int
    fp: int
    fn: int

    @property
    def occupied(self) -> int:
        """Occupied in-motion cells of the observed frame: the same for every tracker."""
        return self.tp + self.fn

    @property
    def f1(self) -> float:
        """F1 of this frame alone; 0 if no cell was occupied and none was forecast."""
        return 2 * self.tp / max(2 * self.tp + self.fp + self.fn, 1)


@dataclass(frozen=True)
class ChosenMoment:
    """The stamp of frame t of a kept forecast, and why it is on the page: `worst`, `different` or `ordinary`."""

    stamp_ns: int
    reason: str


def moments_in_order(
    scores: Mapping[str, Mapping[int, FrameScore]], trackers: Sequence[str]
) -> tuple[ChosenMoment, ...]:
    """Every moment with scores of all trials, in the order of their importance: worst, different and ordinary moments
    in turns.

    `scores`: by label and stamp; `trackers`: the labels that judge moments. Worst: the lowest mean F1 of the trackers,
    if a cell was occupied. Different: the largest range of their F1. Both have moments of few cells last. Ordinary: as
    far in time as possible from the moments before.
    """
    stamps = sorted(set.intersection(*(set(frames) for frames in scores.values()))) if scores else []
    occupied = [s for s in stamps if any(frames[s].occupied for frames in scores.values())]
    f1 = {s: [scores[name][s].f1 for name in trackers] for s in occupied} if trackers else {}
    ranges = {s: max(values) - min(values) for s, values in f1.items()}
    few = {s: max(frames[s].occupied for frames in scores.values()) < FEW_CELLS for s in occupied}
    worst = sorted(f1, key=lambda s: (few[s], sum(f1[s]), s))
    different = sorted((s for s in f1 if ranges[s] >= LEAST_DIFFERENCE), key=lambda s: (few[s], -ranges[s], s))
    queues = {"worst": worst, "different": different, "ordinary": _spread(stamps)}
    chosen: dict[int, str] = {}
    while len(chosen) < len(stamps):
        for reason, queue in queues.items():
            stamp = next((s for s in queue if s not in chosen), None)
            if stamp is not None:
                chosen[stamp] = reason
    return tuple(ChosenMoment(stamp, reason) for stamp, reason in chosen.items())


def _spread(stamps: Sequence[int]) -> list[int]:
    """The stamps, each as far as possible from the stamps before it; the first two are the ends."""
    rest = list(stamps)
    order: list[int] = []
    while rest:
        farthest = max(rest, key=lambda s: (min((abs(s - o) for o in order), default=0), -s))
        rest.remove(farthest)
        order.append(farthest)
    return order


def frame_scores(folder: Path, steps: Sequence[int]) -> dict[int, dict[int, FrameScore]]:
    """The scores of cells in motion by step and stamp, from the sums of a trial. Raises ReportError."""
    try:
        sums = TrialSums(folder)
        counts = sums.by_frame(F1.name, steps, [MAIN_STRATUM], [f"{name} chosen" for name in COUNTS[:3]])
        stamps = sums.frames.stamps_ns.tolist()
    except ScoresError as error:
        raise ReportError(str(error)) from None
    return {
        step: {
            stamp: FrameScore(*(int(count) for count in own))
            for stamp, own in zip(stamps, counts.values[:, s, 0], strict=True)
        }
        for s, step in enumerate(steps)
    }


def forecast_planes(forecast: NDArray[np.float32], thresholds: Sequence[float]) -> NDArray[np.uint8]:
    """A forecast (H, M, M) in [0, 1], quantised; `thresholds` has one for each horizon."""
    levels = np.rint(np.clip(forecast, 0.0, 1.0) * (PACKED_LEVELS - 1)).astype(np.uint8)
    least = np.array(thresholds, np.float32).reshape(-1, 1, 1)
    return np.where(forecast >= least, levels + np.uint8(CALLED), levels).astype(np.uint8)


def pack_moment(seen: Sample, trackers: Sequence[NDArray[np.uint8] | None]) -> str:
    """The input and the targets of `seen`, and the `forecast_planes` of all trackers; a missing forecast is zero."""
    observed = np.where(seen.visible, np.where(seen.occupied, 2, 1), 0).astype(np.uint8)
    targets = seen.state
    if seen.in_motion is not None:
        targets = np.where(seen.in_motion, targets + np.uint8(IN_MOTION), targets)
    nothing = np.zeros(seen.forecast.shape, np.uint8)
    planes = np.concatenate([observed[None], targets, *(nothing if one is None else one for one in trackers)])
    return base64.b64encode(zlib.compress(planes.astype(np.uint8).tobytes(), DEFLATE_LEVEL)).decode()


def level_colours() -> list[list[int]]:
    """Colours (PACKED_LEVELS + 1, 3) sRGB: the levels, then cells that are not visible."""
    at = np.rint(np.linspace(0, SHADES - 1, PACKED_LEVELS)).astype(int)
    return [[int(value) for value in colour] for colour in palette()[[*at, SHADES]]]
