"""Kept forecasts packed for the page: probabilities in PACKED_LEVELS steps, one byte for a cell, deflated, as base64.

A packed moment is planes of M x M bytes, rows from the bottom up: the input (0 not visible, 1 free, 2 occupied); for
each horizon the state of each cell (`evaluation/scoring/target.py`), plus IN_MOTION for the visible cells of that
stratum; and for each tracker and horizon the forecast: its level, plus CALLED from the tracker's threshold on. A kept
probability is exact to 0.5 / 255, so a cell nearer to the threshold than that may be called otherwise than it was
scored.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.referee.samples import Sample
from gridtrack.reports.pictures import SHADES, palette

PACKED_LEVELS = 32
"""Levels of probability: 5 bits."""
CALLED, IN_MOTION = 32, 8
DEFLATE_LEVEL = 8
"""As small as 9 on such planes, in a third of the time."""


@dataclass(frozen=True)
class TrackerPlanes:
    """The forecasts (H, M, M) uint8 of one tracker for one moment, as they are packed."""

    planes: NDArray[np.uint8]

    @classmethod
    def of(cls, forecast: NDArray[np.float32], thresholds: Sequence[float]) -> TrackerPlanes:
        """Quantise a forecast (H, M, M) in [0, 1]; `thresholds` has one for each horizon."""
        levels = np.rint(np.clip(forecast, 0.0, 1.0) * (PACKED_LEVELS - 1)).astype(np.uint8)
        least = np.array(thresholds, np.float32).reshape(-1, 1, 1)
        return cls(np.where(forecast >= least, levels + np.uint8(CALLED), levels).astype(np.uint8))


def pack_moment(seen: Sample, trackers: Sequence[TrackerPlanes | None]) -> str:
    """The input and the targets of `seen` and the forecasts of all trackers; one that has none is all zero."""
    observed = np.where(seen.visible, np.where(seen.occupied, 2, 1), 0).astype(np.uint8)
    targets = seen.state
    if seen.in_motion is not None:
        targets = np.where(seen.in_motion, targets + np.uint8(IN_MOTION), targets)
    nothing = np.zeros(seen.forecast.shape, np.uint8)
    forecasts = [nothing if one is None else one.planes for one in trackers]
    planes = np.concatenate([observed[None], targets, *forecasts])
    return base64.b64encode(zlib.compress(planes.astype(np.uint8).tobytes(), DEFLATE_LEVEL)).decode()


def level_colours() -> list[list[int]]:
    """Colours (PACKED_LEVELS + 1, 3) sRGB: those of the levels, then that of a cell that is not visible."""
    at = np.rint(np.linspace(0, SHADES - 1, PACKED_LEVELS)).astype(int)
    return [[int(value) for value in colour] for colour in palette()[[*at, SHADES]]]
