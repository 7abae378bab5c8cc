"""Vehicles on a given lane: they accelerate, slow down in bends, give way to others, and turn only while moving."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gridtrack.simulation.motion import smoothed, trailing_headings
from gridtrack.simulation.worlds.crowd import CROWD_STEP_S, MoverPath

POINT_EVERY_M = 0.25
BEND_STD_M = 1.2
GAIN_M_S2, BRAKING_M_S2, SIDEWAYS_M_S2 = 1.2, 3.0, 1.8
"""Acceleration, braking, and centripetal acceleration in bends."""
WHEELBASE_SHARE = 0.6
SIDE_CLEARANCE_M, BODY_CLEARANCE_M = 0.5, 0.3
LOOK_AHEAD_S = 1.5
MAX_WAIT_S = 40.0


def ride(
    lane: NDArray[np.float64],
    size_m: tuple[float, float],
    speed: float,
    start_s: float,
    others: Sequence[MoverPath],
    seconds: float,
) -> MoverPath | None:
    """The path of a vehicle along `lane` (n, 2) from beginning to end; it waits for `others` in front of it.

    None if somebody walks into it, or it waits too long.
    """
    points, speeds = _profile(lane, speed)
    first, steps = math.ceil(start_s / CROWD_STEP_S), math.ceil(seconds / CROWD_STEP_S)
    where = _positions(others, first, steps)
    along, velocity, waited_s = 0.0, float(speeds[0]), 0.0
    travelled = []
    for k in range(steps - first):
        travelled.append(along)
        at = min(int(along / POINT_EVERY_M), len(points) - 2)
        ahead = points[at + 1] - points[at]
        blocked = _blocked(where[k], points[at], ahead / np.hypot(*ahead), size_m, velocity)
        wanted = 0.0 if blocked else float(speeds[at : at + 12].min())
        velocity += float(np.clip(wanted - velocity, -BRAKING_M_S2 * CROWD_STEP_S, GAIN_M_S2 * CROWD_STEP_S))
        waited_s += CROWD_STEP_S if velocity < 0.1 else 0.0
        along += velocity * CROWD_STEP_S
        if along >= (len(points) - 2) * POINT_EVERY_M or waited_s > MAX_WAIT_S:
            break
    if len(travelled) < 10 or waited_s > MAX_WAIT_S:
        return None
    known = np.arange(len(points)) * POINT_EVERY_M
    front = np.column_stack([np.interp(travelled, known, column) for column in points.T])
    heading = trailing_headings(front, WHEELBASE_SHARE * size_m[0], math.atan2(*(points[1] - points[0])[::-1]))
    centre = front - size_m[0] / 2.0 * np.column_stack([np.cos(heading), np.sin(heading)])
    path = MoverPath(first, centre, heading)
    return None if _hits(path, size_m, where) else path


def standing_still(x: float, y: float, heading: float, seconds: float) -> MoverPath:
    """The path of a body that does not move."""
    steps = math.ceil(seconds / CROWD_STEP_S)
    return MoverPath(0, np.tile([x, y], (steps, 1)), np.full(steps, heading))


def _profile(lane: NDArray[np.float64], speed: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points (n, 2) along the smoothed lane, POINT_EVERY_M apart, and the maximum speed in its bends (n,)."""
    lengths = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(lane, axis=0).T))])
    even = np.arange(0.0, lengths[-1], POINT_EVERY_M)
    points = smoothed(
        np.column_stack([np.interp(even, lengths, column) for column in lane.T]), BEND_STD_M / POINT_EVERY_M
    )
    direction = np.unwrap(np.arctan2(*np.gradient(points, axis=0).T[::-1]))
    curvature = np.abs(np.gradient(direction)) / POINT_EVERY_M
    return points, np.minimum(speed, np.sqrt(SIDEWAYS_M_S2 / np.maximum(curvature, 1e-6)))


def _positions(others: Sequence[MoverPath], first: int, steps: int) -> NDArray[np.float64]:
    """The positions of the others from step `first`: (steps, others, 2); far away while they are absent."""
    found = np.full((max(steps - first, 1), len(others), 2), 1e9)
    for k, path in enumerate(others):
        begin, end = max(path.first, first), min(path.first + len(path.heading), steps)
        if begin < end:
            found[begin - first : end - first, k] = path.position[begin - path.first : end - path.first]
    return found


def _blocked(
    where: NDArray[np.float64],
    front: NDArray[np.float64],
    ahead: NDArray[np.float64],
    size_m: tuple[float, float],
    velocity: float,
) -> bool:
    """Whether somebody is in front of the vehicle, within its way of the next seconds."""
    offset = where - front
    along = offset @ ahead
    aside = np.abs(offset @ np.array([-ahead[1], ahead[0]]))
    reach_m = 1.2 + velocity * LOOK_AHEAD_S
    return bool(((along > -0.3) & (along < reach_m) & (aside < size_m[1] / 2.0 + SIDE_CLEARANCE_M)).any())


def _hits(path: MoverPath, size_m: tuple[float, float], where: NDArray[np.float64]) -> bool:
    """Whether somebody is inside the vehicle at any time."""
    n = len(path.heading)
    offset = where[:n] - path.position[:, None]
    c, s = np.cos(path.heading)[:, None], np.sin(path.heading)[:, None]
    along = np.abs(c * offset[..., 0] + s * offset[..., 1])
    aside = np.abs(c * offset[..., 1] - s * offset[..., 0])
    near = (along < size_m[0] / 2.0 + BODY_CLEARANCE_M) & (aside < size_m[1] / 2.0 + BODY_CLEARANCE_M)
    return bool(near.any())
