"""Drives through the junction: a laser carried by a car or a delivery robot, or standing beside their path."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2
from gridtrack.common.scene import UNLABELLED, Scene
from gridtrack.simulation.junction import (
    JUNCTION_SET,
    TWO_CORNERS,
    WARM_UP_S,
    View,
    command_of,
    frames_of,
    layout,
    seen,
    simulate_junction,
    simulate_traffic,
)
from gridtrack.simulation.laser import Laser, sweep
from gridtrack.simulation.motion import WheelOdometry
from gridtrack.simulation.sumo import SimulationError
from gridtrack.simulation.tracks import ONLY_LASER, Carrier, Tracks
from gridtrack.simulation.traffic import inside

DRIVE_GRID = "100x0.2"
DRIVE_SEEDS = range(201, 221)
MAX_ODOMETRY_NOISE = 10.0
SEARCH_S = layout.CYCLE_S
"""A drive begins within this time: one signal cycle."""
ROAD_USER_CLEARANCE_M = 0.4
"""Minimum distance of a standing laser from any road user."""
WALL_CLEARANCE_M = 0.15
RASTER_M, MAX_BESIDE_M = 0.2, 15.0
ARM_M = 15.0
"""Further than this from the middle is outside the junction."""


class CarrierType(NamedTuple):
    """A class of road users that can carry the laser."""

    label: str
    passes_within_m: float
    """Maximum distance at which it passes the middle of the junction."""
    track_width_m: float
    """Distance between its wheels."""


CARRIERS = {"car": CarrierType("car", 8.0, 1.5), "robot": CarrierType("pedestrian", 12.0, 0.4)}
"""The robot replaces a pedestrian of the simulation, whom all others avoid."""


@dataclass(frozen=True)
class Drive:
    """The traffic while the road user of track `track` goes through the junction.

    `carrier` is a key of CARRIERS; `command` is the command line of the simulation without its sensor.
    """

    traffic: Tracks
    track: int
    carrier: str
    command: str

    def carried(self, odometry_noise: float = 0.0) -> Tracks:
        """The tracks with the laser in the middle of the road user, facing forward.

        `odometry_noise` from 0 to MAX_ODOMETRY_NOISE scales the errors of wheel odometry; 0: true poses are recorded.
        """
        noise, odometry = "", None
        if odometry_noise:
            wheels_m, seed = CARRIERS[self.carrier].track_width_m, self.traffic.info.noise_seed
            odometry = WheelOdometry(seed=seed, track_width_m=wheels_m).scaled(odometry_noise)
            noise = f" --odometry-noise {odometry_noise:g}"
        return self._seen(f"drive{noise}", Laser(), Carrier(track=self.track, odometry=odometry))

    def beside(self) -> Tracks:
        """The tracks with a standing laser beside the road user's position at half time, facing it.

        The road user is then visible like any other. Raises SimulationError if no place is free.
        """
        path = self.traffic.pose[self.traffic.track == self.track]
        x, y, _ = path[len(path) // 2].tolist()
        return self._seen("beside", standing_beside(self.traffic, x, y), None)

    def _seen(self, sensor: str, laser: Laser, carrier: Carrier | None) -> Tracks:
        view = View(DRIVE_GRID, {ONLY_LASER: laser}, carrier, layout.street_outlines())
        return seen(self.traffic, view, f"{self.command} --carrier {self.carrier} --sensor {sensor}")


def simulate_drive(minutes: float, seed: int, start_s: float, carrier: str) -> Drive:
    """The drive of the road user that moves furthest through the junction in `minutes`.

    It begins within SEARCH_S after `start_s`. Raises ConfigurationError if SUMO is not installed or a value is invalid,
    SimulationError if it fails or no drive is that long.
    """
    frames, kind = frames_of(minutes), CARRIERS[carrier]
    traffic = simulate_traffic(frames + round(SEARCH_S * layout.RATE_HZ), seed, start_s)
    found = furthest(traffic, layout.JUNCTION_CLASSES.index(kind.label), frames, kind.passes_within_m)
    if found is None:
        raise SimulationError(
            f"no {carrier} drives through the junction for {minutes:g} minutes with seed {seed}: try another duration,"
            " such as 0.5 or 1 minutes, or another seed"
        )
    track, first = found
    return Drive(_stretch(traffic, first, frames), track, carrier, command_of(minutes, seed, start_s))


def drive_set() -> Iterator[tuple[str, Tracks]]:
    """Names and tracks of twenty drives, half of them by robots, each with true poses, with wheel odometry and with a
    standing laser; and of the junction's test minutes with lasers on two corners."""
    for seed in DRIVE_SEEDS:
        carrier = list(CARRIERS)[seed % len(CARRIERS)]
        drive = simulate_drive(1.0, seed, WARM_UP_S, carrier)
        yield f"{carrier}-{seed}", drive.carried()
        yield f"{carrier}-{seed}-odometry", drive.carried(1.0)
        yield f"{carrier}-{seed}-beside", drive.beside()
    for name, (minutes, seed, start_s) in JUNCTION_SET.items():
        if name.startswith("test-"):
            yield name.replace("test", "corners"), simulate_junction(minutes, seed, start_s, TWO_CORNERS)


def furthest(traffic: Tracks, label: int, frames: int, passes_within_m: float) -> tuple[int, int] | None:
    """The track of class `label` that moves furthest through the junction in `frames` frames, and the first frame.

    In these frames it is more than ARM_M away from the origin, then nearer than `passes_within_m`, then again more than
    ARM_M away. None if there is no such track.
    """
    best, best_m = None, 0.0
    of_class = np.flatnonzero(traffic.label == label)
    order = of_class[np.lexsort((traffic.frame[of_class], traffic.track[of_class]))]
    for rows in np.split(order, np.flatnonzero(np.diff(traffic.track[order])) + 1):
        starts = np.arange(len(rows) - frames + 1)
        if not starts.size:
            continue
        position = traffic.pose[rows, :2]
        moved = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(position, axis=0).T))])
        radius = np.hypot(*position.T)
        next_outside, next_near = _next(radius > ARM_M), _next(radius < passes_within_m)
        through = next_outside[next_near[next_outside[starts]]] < starts + frames
        distance = np.where(through, moved[starts + frames - 1] - moved[starts], 0.0)
        if distance.max() > best_m:
            best, best_m = (int(traffic.track[rows[0]]), int(traffic.frame[rows[distance.argmax()]])), distance.max()
    return best


def _next(marked: NDArray[np.bool_]) -> NDArray[np.int64]:
    """For each index from 0 to n the next marked index at or after it, or n: (n + 1,)."""
    n = len(marked)
    found = np.append(np.where(marked, np.arange(n), n), n)
    return np.minimum.accumulate(found[::-1])[::-1]


def _stretch(traffic: Tracks, first: int, frames: int) -> Tracks:
    """The tracks of `frames` frames from `first`, which becomes frame 0."""
    kept = traffic.where((traffic.frame >= first) & (traffic.frame < first + frames))
    return replace(kept, info=kept.info.model_copy(update={"frames": frames}), frame=kept.frame - first)


def standing_beside(traffic: Tracks, x: float, y: float) -> Laser:
    """A laser facing (x, y), at the nearest point of a raster beside the lanes that is clear of walls and road
    users."""
    reach = np.arange(-round(MAX_BESIDE_M / RASTER_M), round(MAX_BESIDE_M / RASTER_M) + 1)
    corner = np.round(np.array([x, y]) / RASTER_M)
    places = (np.stack(np.meshgrid(reach, reach), axis=2).reshape(-1, 2) + corner) * RASTER_M
    places = places[np.abs(places).min(axis=1) > layout.LANE_EDGE_M]
    walls = [np.array(outline) for outline in layout.street_outlines()]
    places = places[~np.any([inside(places, outline) for outline in walls], axis=0)]
    distance = np.hypot(*(places - (x, y)).T)
    for place in places[np.argsort(distance, kind="stable")]:
        if _clear_of_walls(walls, place) and _clear_of_road_users(traffic, place):
            facing = math.atan2(y - place[1], x - place[0])
            return Laser(x=round(float(place[0]), 2), y=round(float(place[1]), 2), theta=round(facing, 3))
    raise SimulationError(f"no place within {MAX_BESIDE_M:g} m of ({x:.1f}, {y:.1f}) is free for a standing laser")


def _clear_of_road_users(traffic: Tracks, place: NDArray[np.float64]) -> bool:
    """Whether `place` is more than ROAD_USER_CLEARANCE_M away from the bounding rectangles of all bodies."""
    offset = place - traffic.pose[:, :2]
    c, s = np.cos(traffic.pose[:, 2]), np.sin(traffic.pose[:, 2])
    ahead = np.abs(c * offset[:, 0] + s * offset[:, 1]) - traffic.size[:, 0] / 2.0
    aside = np.abs(c * offset[:, 1] - s * offset[:, 0]) - traffic.size[:, 1] / 2.0
    return bool(np.hypot(np.maximum(ahead, 0.0), np.maximum(aside, 0.0)).min(initial=np.inf) > ROAD_USER_CLEARANCE_M)


def _clear_of_walls(walls: list[NDArray[np.float64]], place: NDArray[np.float64]) -> bool:
    """Whether `place`, outside all static outlines, is more than WALL_CLEARANCE_M away from them."""
    scene = Scene(tuple(outline.astype(np.float32) for outline in walls), UNLABELLED, ())
    ranges, _ = sweep(scene, SE2(*place.tolist()), 0.0, math.radians(1.0), 360, 2.0 * WALL_CLEARANCE_M)
    return bool(ranges.min() > WALL_CLEARANCE_M)
