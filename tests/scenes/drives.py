"""Drives of a laser with known true poses: through a room, along a corridor, past a crowd, over an empty field."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from gridtrack.common.geometry import SE2, wrap_angle
from gridtrack.common.scan import Scan
from gridtrack.common.scene import UNLABELLED, Outline, Scene, SceneObject
from gridtrack.simulation.laser import sweep

PERIOD_S = 0.1
BEAMS, RANGE_MAX_M = 541, 15.0
ANGLE_MIN, STEP = math.radians(-135.0), math.radians(0.5)
NOISE_M = 0.02
START_NS = 10**15


def box(x: float, y: float, length: float, width: float) -> Outline:
    """A rectangle (4, 2), metres, from its lower left corner."""
    return np.array([(x, y), (x + length, y), (x + length, y + width), (x, y + width)], np.float32)


ROOM = (box(-6.0, -4.0, 12.0, 8.0), box(-2.0, 2.5, 0.5, 0.5), box(3.0, -3.0, 0.6, 0.6), box(-5.9, -1.0, 1.0, 0.4))
CORRIDOR = (box(-500.0, -1.2, 1000.0, 0.1), box(-500.0, 1.1, 1000.0, 0.1))
FIELD: tuple[Outline, ...] = ()
_ANGLES = np.arange(12) * math.tau / 12
PERSON = 0.25 * np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1).astype(np.float32)

CAR = np.array([(-2.0, -0.9), (2.0, -0.9), (2.0, 0.9), (-2.0, 0.9)], np.float32)
BARE_STREET = (box(-500.0, -6.1, 1000.0, 0.1), box(-500.0, 6.0, 1000.0, 0.1))
STREET = (*BARE_STREET, *(box(x, y, 0.6, 0.5) for x in range(-6, 22, 4) for y in (-6.0, 5.5)))
"""Two walls, and in the second one pillars on them up to x = 18.6 m."""

Crowd = Callable[[float], list[tuple[float, float]]]
"""Where people stand at a time, seconds: (x, y) metres."""


def around(time_s: float) -> SE2:
    """An ellipse through the room at about 0.8 m/s, heading along it."""
    turn = 0.4 * time_s
    x, y = 3.0 * math.cos(turn), 1.2 * math.sin(turn)
    return SE2(x, y, wrap_angle(math.atan2(1.2 * math.cos(turn), -3.0 * math.sin(turn))))


def straight(time_s: float) -> SE2:
    """Along x at 0.8 m/s, swerving a little."""
    return SE2(0.8 * time_s, 0.1 * math.sin(time_s), 0.1 * math.cos(time_s))


def still(_: float) -> SE2:
    return SE2(1.0, -0.5, 0.3)


def nobody(_: float) -> list[tuple[float, float]]:
    return []


def one_way(time_s: float, people: int = 10) -> list[tuple[float, float]]:
    """People who walk along x at 1.2 m/s through the room, for ever."""
    random = np.random.default_rng(5)
    begin, lane = random.uniform((-6.0, -3.6), (6.0, 3.6), (people, 2)).T
    return [(float((x + 1.2 * time_s + 6.0) % 12.0 - 6.0), float(y)) for x, y in zip(begin, lane, strict=True)]


def away(time_s: float) -> SE2:
    """Along x from rest, 1.5 m/s^2 up to 4.5 m/s."""
    faster_s = min(time_s, 3.0)
    return SE2(0.75 * faster_s**2 + 4.5 * (time_s - faster_s))


def car_in_front(time_s: float) -> list[tuple[float, float]]:
    """A car that keeps 7 m from a sensor on its way `away`."""
    return [(away(time_s).x + 7.0, 0.0)]


def drive(
    static: tuple[Outline, ...],
    path: Callable[[float], SE2],
    scans: int,
    *,
    crowd: Crowd = nobody,
    body: Outline = PERSON,
    odometry_noise: float = 0.0,
    beam_s: float = 0.0,
    sensor: str = "scan",
    mount: SE2 | None = None,
) -> list[Scan]:
    """Scans along `path`; their poses are odometry with drift, their reference poses the true ones.

    With `beam_s` each beam is measured so much later than the one before it. People nearer than 0.6 m are left out.
    `body`: the outline of each.
    """
    random = np.random.default_rng(1)
    made: list[Scan] = []
    last, odometry = path(0.0), path(0.0)
    for k in range(scans):
        true = path(k * PERIOD_S)
        moved = last.inverse() @ true
        slip = odometry_noise * random.standard_normal(2) * (abs(moved.x) + abs(moved.theta))
        odometry = odometry @ SE2(moved.x + slip[0], moved.y, moved.theta + slip[1])
        last = true
        ranges = _ranges(
            static, crowd, body, lambda late_s, k=k: path(k * PERIOD_S + late_s) @ (mount or SE2()), k, beam_s
        )
        noisy = ranges + NOISE_M * random.standard_normal(BEAMS).astype(np.float32)
        scan = Scan(START_NS + round(k * PERIOD_S * 1e9), noisy, ANGLE_MIN, STEP, 0.1, RANGE_MAX_M, sensor)
        made.append(
            replace(
                scan,
                world_T_sensor=odometry @ (mount or SE2()),
                reference_T_sensor=true @ (mount or SE2()),
                time_increment_s=beam_s,
            )
        )
    return made


def _ranges(
    static: tuple[Outline, ...], crowd: Crowd, body: Outline, pose: Callable[[float], SE2], k: int, beam_s: float
) -> np.typing.NDArray[np.float32]:
    """Ranges (B,) of the laser; with beam times in 90 sectors, each from the pose at its middle."""
    here = pose(0.0)
    people = [(x, y) for x, y in crowd(k * PERIOD_S) if math.hypot(x - here.x, y - here.y) > 0.6]
    bodies = tuple(SceneObject(n, UNLABELLED, SE2(x, y), body) for n, (x, y) in enumerate(people))
    scene = Scene(static, UNLABELLED, bodies)
    if not beam_s:
        return sweep(scene, here, ANGLE_MIN, STEP, BEAMS, RANGE_MAX_M)[0]
    parts = []
    for part in np.array_split(np.arange(BEAMS), 90):
        at = pose(float(part.mean()) * beam_s)
        parts.append(sweep(scene, at, ANGLE_MIN + STEP * part[0], STEP, len(part), RANGE_MAX_M)[0])
    return np.concatenate(parts)
