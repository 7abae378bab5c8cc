"""Worlds: small places, each with its laser and people drawn at random from one seed."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import version

import numpy as np

from gridtrack.common.errors import ConfigurationError
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec
from gridtrack.recordings.recording_info import RecordingInfo
from gridtrack.simulation.laser import sweep
from gridtrack.simulation.sumo import SimulationError, sumo_version
from gridtrack.simulation.tracks import ONLY_LASER, Tracks
from gridtrack.simulation.worlds import indoors, outdoors
from gridtrack.simulation.worlds.compose import CLASSES, WORLD_LICENCE, compose
from gridtrack.simulation.worlds.people import on_foot
from gridtrack.simulation.worlds.scenery import Scenery
from gridtrack.simulation.worlds.sensors import draw_sensor
from gridtrack.simulation.worlds.streets import streets

PlaceGenerator = Callable[[np.random.Generator], Scenery]

INDOORS: dict[str, PlaceGenerator] = {
    "room": indoors.room,
    "office": indoors.office,
    "hall": indoors.hall,
    "corridor": indoors.corridor,
}
OUTDOORS: dict[str, PlaceGenerator] = {"plaza": outdoors.plaza, "car-park": outdoors.car_park}
STREETS = {"street": False, "crossing": True}
"""Outdoors; True: the laser is at a crossing."""
KINDS = (*INDOORS, *OUTDOORS, *STREETS)
MAX_WORLD_MINUTES = 10.0
SEED_DOMAIN = 19
"""Separates the random numbers from other simulations with the same seed."""
ATTEMPTS = 40
LEAST_SEEN = 0.3
"""Minimum `seen_share` of a world; else another one is drawn."""
EVERY_S = 1.0
LEAST_BEAMS = 2
MOVED_M = 1.0


def kind_of(seed: int) -> str:
    """The kind of the world of a seed; successive seeds cycle through all kinds."""
    return KINDS[seed % len(KINDS)]


def world_name(seed: int) -> str:
    """The name of the world's file without its suffix."""
    kind = kind_of(seed)
    return f"{'indoors' if kind in INDOORS else 'outdoors'}-{kind}-{seed}"


def world_command(seed: int, minutes: float) -> str:
    """The command line of a world."""
    return f"gridtrack simulate worlds --count 1 --minutes {minutes:g} --seed {seed}"


def summary_of(tracks: Tracks) -> str:
    """The road users and the laser of a world in one line."""
    info, seen = tracks.info, tracks.without_carrier()
    _, first = np.unique(seen.track, return_index=True)
    counts = np.bincount(seen.label[first], minlength=len(CLASSES))
    users = ", ".join(f"{count} {name}" for count, name in zip(counts.tolist(), CLASSES, strict=True) if count)
    laser = next(iter(info.lasers.values()))
    carried = "stands" if info.carrier is None else "drives" if info.carrier.odometry is None else "drives by odometry"
    return f"{users or 'nobody'}; a laser {carried}: {info.rate_hz:g} Hz, {laser.beams} beams to {laser.range_max:g} m"


def simulate_world(seed: int, minutes: float) -> Tracks:
    """The world of a seed; same seed and minutes, same tracks.

    Raises ConfigurationError for invalid minutes, SimulationError if no attempt gives a usable place.
    """
    if not 0.0 < minutes <= MAX_WORLD_MINUTES:
        raise ConfigurationError(f"{minutes:g} minutes: expected more than 0 and at most {MAX_WORLD_MINUTES:g}")
    for attempt in range(ATTEMPTS):
        try:
            tracks = _attempt(seed, minutes, np.random.default_rng([SEED_DOMAIN, seed, attempt]))
            if seen_share(tracks) >= LEAST_SEEN:
                return tracks
            reason = SimulationError("too few road users in view")
        except SimulationError as error:
            reason = error
    raise SimulationError(f"world {seed}: {reason} in {ATTEMPTS} attempts; take another seed") from reason


def _attempt(seed: int, minutes: float, random: np.random.Generator) -> Tracks:
    kind = kind_of(seed)
    sensor = draw_sensor(random, kind not in INDOORS)
    frames = max(round(minutes * 60.0 * sensor.rate_hz), 1)
    if kind in STREETS:
        scenery, movers, view = streets(STREETS[kind], sensor, minutes * 60.0, seed, random)
        made_with = {"eclipse-sumo": sumo_version()}
    else:
        scenery = (INDOORS | OUTDOORS)[kind](random)
        movers, view = on_foot(scenery, sensor, minutes * 60.0, seed, random)
        made_with = {"jupedsim": version("jupedsim")}
    recording = RecordingInfo(
        site=f"world-{seed}",
        classes=CLASSES,
        rate_hz=sensor.rate_hz,
        licence=WORLD_LICENCE,
        credit="simulated with JuPedSim and Eclipse SUMO" if kind in STREETS else "simulated with JuPedSim",
        command=world_command(seed, minutes),
    )
    return compose(recording, scenery.at(sensor.plane_m), movers, view, frames, seed, made_with)


def seen_share(tracks: Tracks) -> float:
    """The share of the seconds of a world in which at least LEAST_BEAMS beams end on moving road users.

    Road users that move less than MOVED_M in all, such as parked cars, do not count.
    """
    info = tracks.info
    laser, poses = info.lasers[ONLY_LASER], tracks.sensor_poses(ONLY_LASER)
    grid = GridSpec.parse(info.recording.grid or "")
    half_m = grid.size * grid.cell_m / 2.0
    every = max(round(EVERY_S * info.rate_hz), 1)
    of_track = {number: tracks.pose[tracks.track == number, :2] for number in np.unique(tracks.track).tolist()}
    moving = [number for number, position in of_track.items() if np.ptp(position, axis=0).max() > MOVED_M]
    sampled = tracks.where(np.isin(tracks.track, moving) & (tracks.frame % every == 0))
    seen = []
    for frame, scene in enumerate(sampled.scenes()):
        if frame % every == 0:
            beams = (laser.angle_min, laser.angle_increment, laser.beams, min(laser.range_max, half_m))
            _, labels = sweep(scene, SE2(*poses[frame].tolist()), *beams)
            on_users = labels < info.recording.classes.index("static")
            seen.append(int(on_users.sum()) >= LEAST_BEAMS)
    return float(np.mean(seen))
