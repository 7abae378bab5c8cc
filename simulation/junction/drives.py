"""Drives through the junction: lasers carried by a car or by a delivery robot, and one that stands beside their way."""

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
"""A drive begins within this time: one cycle of the signals."""
ROAD_USER_CLEARANCE_M = 0.4
"""Between a laser that stands beside a way and any road user."""
WALL_CLEARANCE_M = 0.15
RASTER_M, MAX_BESIDE_M = 0.2, 15.0


ARM_M = 15.0
"""Further than this from the middle is outside the junction."""


class CarrierType(NamedTuple):
    """A class of road users one of which carries the laser, how near to the middle of the junction it passes, and the
    distance between its wheels."""

    label: str
    passes_within_m: float
    track_width_m: float


CARRIERS = {"car": CarrierType("car", 8.0, 1.5), "robot": CarrierType("pedestrian", 12.0, 0.4)}
"""The robot has the path of a pedestrian of the simulation, whom all others avoid."""


@dataclass(frozen=True)
class Drive:
    """The traffic while the road user of track `track` goes through the junction.

    `carrier` is one of CARRIERS; `command` is the command line that repeats the simulation, less its sensor.
    """

    traffic: Tracks
    track: int
    carrier: str
    command: str

    def carried(self, odometry_noise: float = 0.0) -> Tracks:
        """With the laser in the middle of the road user, looking ahead.

        `odometry_noise` from 0 to MAX_ODOMETRY_NOISE multiplies the errors of wheel odometry; with 0 the recorded poses
        are the true ones.
        """
        noise, odometry = "", None
        if odometry_noise:
            wheels_m, seed = CARRIERS[self.carrier].track_width_m, self.traffic.info.noise_seed
            odometry = WheelOdometry(seed=seed, track_width_m=wheels_m).scaled(odometry_noise)
            noise = f" --odometry-noise {odometry_noise:g}"
        return self._seen(f"drive{noise}", Laser(), Carrier(track=self.track, odometry=odometry))

    def beside(self) -> Tracks:
        """With the laser standing where the road user is at half time, as near as nobody comes, and facing that place.

        The road user is then one as any other. Raises SimulationError where there is no such place.
        """
        path = self.traffic.pose[self.traffic.track == self.track]
        x, y, _ = path[len(path) // 2].tolist()
        return self._seen("beside", standing_beside(self.traffic, x, y), None)

    def _seen(self, sensor: str, laser: Laser, carrier: Carrier | None) -> Tracks:
        view = View(DRIVE_GRID, {ONLY_LASER: laser}, carrier, layout.street_outlines())
        return seen(self.traffic, view, f"{self.command} --carrier {self.carrier} --sensor {sensor}")


def simulate_drive(minutes: float, seed: int, start_s: float, carrier: str) -> Drive:
    """The drive of the road user who moves furthest in `minutes`, of those that go through the junction.

    It begins within SEARCH_S after `start_s`. Raises ConfigurationError where SUMO is not installed or a value is
    invalid, SimulationError where it fails or nobody drives for so long.
    """
    frames, kind = frames_of(minutes), CARRIERS[carrier]
    traffic = simulate_traffic(frames + round(SEARCH_S * layout.RATE_HZ), seed, start_s)
    found = furthest(traffic, layout.JUNCTION_CLASSES.index(kind.label), frames, kind.passes_within_m)
    if found is None:
        raise SimulationError(
            f"no {carrier} goes through the junction in a stretch of {minutes:g} minutes with seed {seed}: try another"
            " time, such as 0.5 or 1 minutes, or another seed"
        )
    track, first = found
    return Drive(_stretch(traffic, first, frames), track, carrier, command_of(minutes, seed, start_s))


def drive_set() -> Iterator[tuple[str, Tracks]]:
    """The names and tracks of twenty drives, half of them by robots, with true poses, with wheel odometry, and with a
    laser that stands beside them; and of the junction's test minutes with lasers on two corners."""
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
    """The track of class `label`, and the first of `frames` successive frames, that move furthest through the junction.

    In these frames it is more than ARM_M away from the origin, then nearer than `passes_within_m`, then again more than
    ARM_M away. None where no track does.
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
    """For each index up to the length n the next marked one from it on, n where there is none: (n + 1,)."""
    n = len(marked)
    found = np.append(np.where(marked, np.arange(n), n), n)
    return np.minimum.accumulate(found[::-1])[::-1]


def _stretch(traffic: Tracks, first: int, frames: int) -> Tracks:
    """The tracks of the frames from `first` on, which becomes frame 0."""
    kept = traffic.where((traffic.frame >= first) & (traffic.frame < first + frames))
    return replace(kept, info=kept.info.model_copy(update={"frames": frames}), frame=kept.frame - first)


def standing_beside(traffic: Tracks, x: float, y: float) -> Laser:
    """A laser that faces (x, y), on a raster beside the lanes, as near as no wall and no road user comes."""
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
    raise SimulationError(f"no place within {MAX_BESIDE_M:g} m of ({x:.1f}, {y:.1f}) is free for a laser that stands")


def _clear_of_road_users(traffic: Tracks, place: NDArray[np.float64]) -> bool:
    """Whether `place` is more than ROAD_USER_CLEARANCE_M away from the rectangles around all bodies."""
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
