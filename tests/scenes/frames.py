"""Frames from planes of cells or from the scan of a laser, sources of them for a training, and cards of weights."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.common.raycast import cast_scan
from gridtrack.common.scan import Scan
from gridtrack.common.scene import UNLABELLED, Scene
from gridtrack.simulation.laser import Laser, sweep
from gridtrack.trackers.training.card import Card


def frame_of(occupied, visible=None, *, grid: GridSpec | None = None, second=0.0, x=0.0, y=0.0) -> GridFrame:
    """A frame with these cells (M, M), by default of 1 m and all visible, with its window at (x, y) in the world."""
    occupied = np.asarray(occupied, bool)
    visible = np.ones_like(occupied) if visible is None else np.asarray(visible, bool)
    points = (grid or GridSpec(len(occupied), 1.0)).cell_centres(occupied & visible)
    sensor, owner = np.zeros((1, 2), np.float32), np.zeros(len(points), np.uint8)
    return GridFrame(round(second * 1e9), visible, occupied & visible, SE2(x, y), sensor, points, owner)


def scanned(
    laser: Laser, outlines: Sequence[np.ndarray], grid: GridSpec, *, second=0.0, noise=None, raw=False
) -> GridFrame:
    """The frame of a laser at the origin that sees outlines (N, 2), metres; `noise` (B,) is added to its ranges.

    Its points are the returns themselves if `raw`, else the centres of the occupied cells.
    """
    beams = (laser.angle_min, laser.angle_increment)
    scene = Scene(tuple(np.asarray(outline, np.float32) for outline in outlines), UNLABELLED, ())
    ranges, _ = sweep(scene, SE2(), *beams, laser.beams, laser.range_max)
    ranges = ranges if noise is None else (ranges + noise).astype(np.float32)
    visible, occupied = np.zeros((2, *grid.shape), bool)
    returns = cast_scan(Scan(0, ranges, *beams, laser.range_min, laser.range_max), grid, SE2(), visible, occupied)
    points = returns if raw else grid.cell_centres(occupied)
    sensor, owner = np.zeros((1, 2), np.float32), np.zeros(len(points), np.uint8)
    return GridFrame(round(second * 1e9), visible, occupied, SE2(), sensor, points, owner)


@dataclass
class Frames:
    """A source of frames."""

    frames: list[GridFrame]
    grid: GridSpec
    period_s: float = 0.1
    name: str = "rec@0s-1s"
    sha256: str = "ab"
    site: str = "here"
    classes: tuple[str, ...] = ()

    def __iter__(self) -> Iterator[GridFrame]:
        return iter(self.frames)

    def __len__(self) -> int:
        return len(self.frames)


def card_of(tracker: str, grid: GridSpec, period_s: float, site: str = "here", **fields) -> Card:
    """The card of weights that were made without a training."""
    made = {"world_T_grid": (0.0, 0.0), "seed": 0, "command": "", "train": ()}
    return Card(tracker=tracker, site=site, grid=str(grid), period_s=period_s, **made | fields)
