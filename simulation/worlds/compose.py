"""Composition of a world: the tracks of a recording from a place, the paths of its road users, and a sensor."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import Polygon

from gridtrack.common.geometry import SE2
from gridtrack.recordings.recording_info import RecordingInfo
from gridtrack.simulation.bodies import Walker
from gridtrack.simulation.motion import WheelOdometry
from gridtrack.simulation.tracks import MAX_OUTLINES, ONLY_LASER, Carrier, Tracks, TracksInfo, World
from gridtrack.simulation.worlds.crowd import CROWD_STEP_S, MoverPath
from gridtrack.simulation.worlds.scenery import Thing, placed
from gridtrack.simulation.worlds.sensors import WorldSensor

CLASSES = ("pedestrian", "cyclist", "car", "bus", "static")
WORLD_LICENCE = "BSD-3-Clause"


@dataclass(frozen=True)
class Mover:
    """A road user: its path, class, length and width, and the build of a person."""

    path: MoverPath
    label: str
    size_m: tuple[float, float]
    walker: Walker | None = None


@dataclass(frozen=True)
class WorldView:
    """A sensor that stands at `pose`, or is carried by the mover with the index `carrier`."""

    sensor: WorldSensor
    pose: SE2
    carrier: int | None = None
    odometry: WheelOdometry | None = None


def compose(
    recording: RecordingInfo,
    things: Sequence[Thing],
    movers: Sequence[Mover],
    view: WorldView,
    frames: int,
    seed: int,
    made_with: dict[str, str],
) -> Tracks:
    """The tracks of `frames` frames from step 0 of the paths; the world frame is the first pose of the laser."""
    sensor, world_T_place = view.sensor, view.pose.inverse()
    times = np.arange(frames) / sensor.rate_hz
    rows = [_rows(number, mover, times, world_T_place) for number, mover in enumerate(movers)]
    frame, track, pose = (np.concatenate(column) for column in zip(*rows, strict=True))
    carried = pose[track == view.carrier] if view.carrier is not None else np.zeros((1, 3))
    near = _near(pose, frame if view.carrier is not None else np.zeros_like(frame), carried, sensor.laser.range_max)
    near |= track == view.carrier if view.carrier is not None else False
    kept = list(_nearest(things, world_T_place, carried, sensor.laser.range_max))
    walkers = {number: mover.walker for number, mover in enumerate(movers) if mover.walker is not None}
    seen = set(track[near].tolist())
    info = TracksInfo(
        recording=recording.model_copy(update={"grid": _grid(sensor.grid(view.carrier is None))}),
        lasers={ONLY_LASER: sensor.laser},
        frames=frames,
        rate_hz=sensor.rate_hz,
        noise_seed=seed,
        static=tuple(_rounded(thing.corners, world_T_place) for thing in kept),
        static_class="static",
        made_with=made_with,
        carrier=None if view.carrier is None else Carrier(track=view.carrier, odometry=view.odometry),
        world=World(
            plane_m=sensor.plane_m,
            walkers={number: walker for number, walker in walkers.items() if number in seen and number != view.carrier},
            glass=frozenset(k for k, thing in enumerate(kept) if thing.glass),
            dark=frozenset(k for k, thing in enumerate(kept) if thing.dark),
        ),
    )
    order = np.lexsort((track, frame))[near[np.lexsort((track, frame))]]
    labels = np.array([CLASSES.index(mover.label) for mover in movers])
    sizes = np.array([mover.size_m for mover in movers])
    return Tracks(info, frame[order], track[order], labels[track[order]], pose[order], sizes[track[order]]).rounded()


def _grid(text: str) -> str:
    return RecordingInfo(site="any", grid=text).grid or text


def _rows(
    number: int, mover: Mover, times: NDArray[np.float64], world_T_place: SE2
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Frame, track and pose of a mover in all frames within the time of its path."""
    path = mover.path
    known = (np.arange(len(path.heading)) + path.first) * CROWD_STEP_S
    frame = np.flatnonzero((times >= known[0]) & (times <= known[-1]))
    columns = (*path.position.T, np.unwrap(path.heading))
    x, y, heading = (np.interp(times[frame], known, column) for column in columns)
    position = world_T_place.apply(np.column_stack([x, y]))
    pose = np.column_stack([position, heading + world_T_place.theta])
    return frame, np.full(len(frame), number), pose


def _near(
    pose: NDArray[np.float64], frame: NDArray[np.int64], sensor: NDArray[np.float64], range_m: float
) -> NDArray[np.bool_]:
    """Which rows (N,) are within the range of the sensor with the poses `sensor` (frames, 3)."""
    offset = pose[:, :2] - sensor[frame, :2]
    return np.hypot(offset[:, 0], offset[:, 1]) < range_m + 6.0


def _nearest(things: Sequence[Thing], world_T_place: SE2, sensor: NDArray[np.float64], range_m: float) -> list[Thing]:
    """The things in range of the sensor's path, in their order; at most the MAX_OUTLINES nearest ones."""
    way = shapely.MultiPoint(sensor[:: max(len(sensor) // 50, 1), :2])
    distances = [way.distance(Polygon(_rounded(thing.corners, world_T_place))) for thing in things]
    order = sorted(range(len(things)), key=lambda k: (distances[k], k))[:MAX_OUTLINES]
    return [things[k] for k in sorted(order) if distances[k] < range_m]


def _rounded(corners: Sequence[tuple[float, float]], world_T_place: SE2) -> tuple[tuple[float, float], ...]:
    moved = placed(corners, world_T_place.x, world_T_place.y, world_T_place.theta)
    return tuple((round(x, 3) + 0.0, round(y, 3) + 0.0) for x, y in moved)


def straight_view(path: MoverPath) -> SE2:
    """The pose of a path at step 0."""
    k = min(max(-path.first, 0), len(path.heading) - 1)
    x, y = path.position[k].tolist()
    return SE2(x, y, math.remainder(float(path.heading[k]), math.tau))
