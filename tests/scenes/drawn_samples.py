"""Two samples of forecasts drawn by hand: nine cells in a window that is turned, and a walker in the first of them."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.evaluation.referee.referee import ScoredForecast
from gridtrack.evaluation.referee.samples import RobotPaths, SampleWriter
from gridtrack.evaluation.referee.strata import region_maps_of
from gridtrack.evaluation.referee.targets import Target
from gridtrack.trackers.contract import Forecast, TrackedObject

GRID = GridSpec(3, 0.5, (-1.0, 2.0))
WINDOW = SE2(10.0, -4.0, math.pi / 2)
STAMP_NS = 1_700_000_000_123_456_789
SEEN = np.array([[1, 1, 0], [1, 1, 0], [0, 0, 0]], bool)
HIT = np.array([[0, 1, 0], [0, 0, 0], [0, 0, 0]], bool)
LATER = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 0]], bool)
STATE = np.array([[0, 0, 2], [1, 0, 3], [4, 4, 4]], np.uint8)
FORECAST = np.array([[0, 0.25, 0], [1, 0.5, 0], [0, 0, 0.2]], np.float32)
BOX, VELOCITY = np.array([-0.5, 2.5, 0.5, 0.8, 0.4], np.float32), np.array([0.6, -0.8], np.float32)
ROBOTS = RobotPaths(
    places=np.array([[-0.5, 2.25], [0.25, 3.0], [0.0, 2.5]], np.float32),
    velocities=np.array([[0.5, 0.0], [0.0, -1.0], [0.0, 0.0]], np.float32),
    until_s=np.array([0.5, 1.0, 1.0], np.float32),
    contact=np.array([1, 0, 0], np.float32),
    risks=np.array([0.25, 0.75, np.nan], np.float32),
)
"""A contact, a clear path, and one whose risk is not known."""
WALKER = TrackedObject(7, BOX, VELOCITY, np.eye(4, dtype=np.float32))


def scored(seconds: int, objects: tuple[TrackedObject, ...]) -> ScoredForecast:
    """Ten frames a second; at step 10 the hit is a cell further, and the forecast is FORECAST."""
    targets = []
    for step in range(11):
        stamp_ns = STAMP_NS + seconds * 1_000_000_000 + step * 100_000_000
        origins, nothing = np.array([[0.25, 0.5]], np.float32), np.zeros((0, 2), np.float32)
        occupied = LATER if step == 10 else HIT
        frame = GridFrame(stamp_ns, SEEN, occupied, SE2(), origins, nothing, np.zeros(0, np.uint8))
        target = Target.of_frame(frame)
        targets.append(replace(target, state=STATE) if step == 10 else target)
    occupancy = np.zeros((11, 3, 3), np.float32)
    occupancy[10] = FORECAST
    maps = region_maps_of(np.zeros(GRID.shape, np.uint8), GRID, np.array([[0.25, 0.5]], np.float32))
    ages = np.zeros(GRID.shape, np.uint8)
    return ScoredForecast(Forecast(occupancy, objects=objects), tuple(targets), maps, ages, WINDOW)


def write_samples(path: Path, seconds: tuple[int, ...] = (0, 1)) -> None:
    """The samples at these seconds; the walker is in that of second 0."""
    with SampleWriter(path, GRID, 0.1, 10) as writer:
        for second in seconds:
            writer.add(scored(second, () if second else (WALKER,)), None if second else ROBOTS)
