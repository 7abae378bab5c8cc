"""A hall: a laser in a corner, moving discs as pedestrians, and the weights of a tracker for the hall."""

from __future__ import annotations

import numpy as np

from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.simulation.laser import Laser
from gridtrack.trackers.training.calibration import IDENTITY
from gridtrack.trackers.training.card import Card

from scenes.frames import card_of, scanned

GRID = GridSpec(60, 0.1, (0.0, -3.0))
PERIOD_S = 0.1
LASER = Laser(angle_min=-np.pi / 2, angle_increment=np.pi / 511, beams=512, range_min=0.02, range_max=6.0)
CIRCLE = np.stack([np.cos(np.arange(48) * np.pi / 24), np.sin(np.arange(48) * np.pi / 24)], axis=1)
PERSON, PILLAR = 0.2 * CIRCLE, 0.15 * CIRCLE + [2.0, 4.0]
GLIDING = np.zeros((31, 31), np.float32)
"""The life table of returns that never stay in place."""
OPEN = {
    "occupancy_rate": np.full(GRID.shape, 1e-3, np.float32),
    "neighbourhood_rate": np.zeros(GRID.shape, np.float32),
    "calibration": IDENTITY,
}
"""The map of the empty hall."""


def frame_of(people: list[tuple[float, float]], step: int = 0, wall: bool = False) -> GridFrame:
    """The frame of a laser at the origin, of discs at the given positions, with or without a pillar."""
    return scanned(LASER, [*(PERSON + place for place in people), *[PILLAR] * wall], GRID, second=0.1 * step)


def card(**settings) -> Card:
    return card_of("kalman", GRID, PERIOD_S, "hall", settings=settings)


def walk(start, velocity, steps):
    return [(start[0] + velocity[0] * PERIOD_S * n, start[1] + velocity[1] * PERIOD_S * n) for n in range(steps)]
