"""A hall: a laser in a corner, moving discs as pedestrians, and the weights of a tracker for the hall."""

from __future__ import annotations

import numpy as np

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.common.raycast import cast_scan
from gridtrack.common.scan import Scan
from gridtrack.trackers.training.calibration import IDENTITY
from gridtrack.trackers.training.card import Card

GRID = GridSpec(60, 0.1, (0.0, -3.0))
PERIOD_S = 0.1
RADIUS_M = 0.2
WALL = (2.0, 4.0, 0.15)
"""Centre and radius of a pillar in the background, metres."""
GLIDING = np.zeros((31, 31), np.float32)
"""The life table of returns that never stay in place."""
OPEN = {
    "occupancy_rate": np.full(GRID.shape, 1e-3, np.float32),
    "neighbourhood_rate": np.zeros(GRID.shape, np.float32),
    "calibration": IDENTITY,
}
"""The map of the empty hall."""


def frame_of(people: list[tuple[float, float]], step: int = 0, wall: bool = False) -> GridFrame:
    """The frame of a laser at the origin, of discs at the given positions, with or without the pillar."""
    angles = -np.pi / 2 + np.arange(512) * np.pi / 511
    beams = np.stack([np.cos(angles), np.sin(angles)], 1)
    ranges = np.full(512, np.inf)
    for x, y, radius in [(x, y, RADIUS_M) for x, y in people] + ([WALL] if wall else []):
        along = beams @ np.array([x, y])
        inside = radius**2 - (x * x + y * y - along**2)
        hit = (inside > 0) & (along > 0)
        ranges[hit] = np.minimum(ranges[hit], along[hit] - np.sqrt(inside[hit]))
    visible, occupied = np.zeros(GRID.shape, bool), np.zeros(GRID.shape, bool)
    scan = Scan(0, ranges.astype(np.float32), -np.pi / 2, np.pi / 511, 0.02, 6.0)
    cast_scan(scan, GRID, SE2(), visible, occupied)
    points = GRID.cell_centres(occupied)
    origin = np.zeros((1, 2), np.float32)
    return GridFrame(step * 100_000_000, visible, occupied, SE2(), origin, points, np.zeros(len(points), np.uint8))


def card(**settings) -> Card:
    return Card(
        tracker="kalman",
        site="hall",
        grid=str(GRID),
        period_s=PERIOD_S,
        world_T_grid=(0.0, 0.0),
        seed=0,
        command="",
        train=(),
        settings=settings,
    )


def walk(start, velocity, steps):
    return [(start[0] + velocity[0] * PERIOD_S * n, start[1] + velocity[1] * PERIOD_S * n) for n in range(steps)]
