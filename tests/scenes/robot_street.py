"""A drive past walls, posts and people: the view of a laser on a robot, in a window that follows it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.common.raycast import cast_scan
from gridtrack.common.scan import Scan
from gridtrack.common.scene import UNLABELLED, Scene
from gridtrack.simulation.laser import Laser, sweep, with_noise

GRID, PERIOD_S, SPEED_MPS = GridSpec(100, 0.2), 0.125, 1.2
LASER = Laser()
Walker = Callable[[float], tuple[float, float]]
"""Position, metres in the world, at a time in seconds."""


class Seen(NamedTuple):
    """A frame, its time in seconds, and where the window lies in the world, (2,) metres."""

    frame: GridFrame
    time_s: float
    corner: np.ndarray


def rectangle(x: float, y: float, length: float, width: float, heading: float = 0.0) -> np.ndarray:
    corners = np.array([(-length, -width), (length, -width), (length, width), (-length, width)]) / 2
    c, s = math.cos(heading), math.sin(heading)
    return (corners @ np.array([[c, s], [-s, c]]) + [x, y]).astype(np.float32)


def post(x: float, y: float, radius: float = 0.2) -> np.ndarray:
    angles = np.linspace(0.0, 2 * np.pi, 12, endpoint=False)
    return (np.stack([np.cos(angles), np.sin(angles)], axis=1) * radius + [x, y]).astype(np.float32)


def street(length_m: float) -> tuple[np.ndarray, ...]:
    """Walls with gaps on the left, boxes that stand askew on the right, posts along both."""
    draw, outlines = np.random.default_rng(0), []
    for x in np.arange(-15.0, length_m + 15.0, 8.0):
        turn, aside = draw.uniform(-0.15, 0.15), draw.uniform(-0.5, 0.5)
        outlines.append(rectangle(x, 6.0 + aside, draw.uniform(3.0, 7.0), 0.6, turn))
        outlines.append(rectangle(x + 4.0, -7.0 + aside, draw.uniform(2.0, 5.0), 1.8, 2 * turn))
        outlines += [post(x + draw.uniform(0, 4), side, draw.uniform(0.1, 0.25)) for side in (3.6, -4.2)]
    return tuple(outlines)


def drive(seconds: float, walkers: tuple[Walker, ...] = (), pose_noise_m: float = 0.0, seed: int = 0) -> Iterator[Seen]:
    """The frames of a laser that drives along x, in a slalom, with range noise and an error of its pose."""
    random, walls = np.random.default_rng(seed), street(SPEED_MPS * seconds)
    for step in range(round(seconds / PERIOD_S)):
        time_s = step * PERIOD_S
        x = SPEED_MPS * time_s
        pose = SE2(x, 0.8 * math.sin(0.25 * x), math.atan(0.2 * math.cos(0.25 * x)))
        scene = Scene((*walls, *(post(*walker(time_s), 0.25) for walker in walkers)), UNLABELLED, ())
        ranges, _ = sweep(scene, pose, LASER.angle_min, LASER.angle_increment, LASER.beams, LASER.range_max)
        error = random.normal(0.0, 1.0, 3) * (pose_noise_m, pose_noise_m, 0.2 * pose_noise_m)
        reported = SE2(pose.x + error[0], pose.y + error[1], pose.theta + error[2])
        corner = np.round(np.array([reported.x, reported.y]) / GRID.cell_m) * GRID.cell_m
        grid_T_sensor = SE2(reported.x - corner[0], reported.y - corner[1], reported.theta)
        visible, occupied = np.zeros(GRID.shape, bool), np.zeros(GRID.shape, bool)
        noisy = with_noise(ranges, LASER.range_max, random)
        scan = Scan(0, noisy, LASER.angle_min, LASER.angle_increment, LASER.range_min, LASER.range_max)
        cast_scan(scan, GRID, grid_T_sensor, visible, occupied)
        points, origin = GRID.cell_centres(occupied), np.array([[grid_T_sensor.x, grid_T_sensor.y]], np.float32)
        owner, window = np.zeros(len(points), np.uint8), SE2(*corner.tolist())
        frame = GridFrame(round(time_s * 1e9), visible, occupied, window, origin, points, owner)
        yield Seen(frame, time_s, corner)
