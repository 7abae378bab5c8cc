"""Worlds: many small places, no two alike, each with its laser and its people, from one seed."""

from __future__ import annotations

import math
from collections.abc import Callable
from importlib.metadata import version

import numpy as np

from gridtrack.common.errors import ConfigurationError
from gridtrack.common.geometry import SE2
from gridtrack.common.scene import Outline
from gridtrack.recordings.recording import RecordingInfo
from gridtrack.simulation.odometry import WheelOdometry
from gridtrack.simulation.sumo import SimulationError
from gridtrack.simulation.tracks import Corner, Tracks
from gridtrack.simulation.worlds import indoors
from gridtrack.simulation.worlds.compose import CLASSES, WORLD_LICENCE, Mover, WorldView, compose, straight_view
from gridtrack.simulation.worlds.crowd import CROWD_STEP_S, MoverPath, swaying, walk
from gridtrack.simulation.worlds.plans import Planner, build, robot_plan, torso
from gridtrack.simulation.worlds.scenery import Scenery
from gridtrack.simulation.worlds.sensors import WorldSensor, draw_sensor, standing_pose

PlaceGenerator = Callable[[np.random.Generator], Scenery]

INDOORS: dict[str, PlaceGenerator] = {
    "room": indoors.room,
    "office": indoors.office,
    "hall": indoors.hall,
    "corridor": indoors.corridor,
}
OUTDOORS: dict[str, PlaceGenerator] = {}
KINDS = (*INDOORS, *OUTDOORS)
MAX_WORLD_MINUTES = 10.0
SEED_DOMAIN = 19
"""Worlds share no random numbers with other simulations of the same seed."""
RUN_IN_S, AFTER_S = 10.0, 1.0
DRIVING = 0.35
"""Share of worlds whose laser drives."""
ROBOT_SIZE_M = (0.5, 0.45)
SITTING = 0.5
ATTEMPTS = 5


def kind_of(seed: int) -> str:
    """The kind of the world of a seed: all kinds are equally frequent in a row of seeds."""
    return KINDS[seed % len(KINDS)]


def world_name(seed: int) -> str:
    """The name of the world's file, without its suffix."""
    kind = kind_of(seed)
    return f"{'indoors' if kind in INDOORS else 'outdoors'}-{kind}-{seed}"


def world_command(seed: int, minutes: float) -> str:
    """The command line that repeats a world."""
    return f"gridtrack simulate worlds --count 1 --minutes {minutes:g} --seed {seed}"


def summary_of(tracks: Tracks) -> str:
    """Who moves in a world, and what watches it, in a line."""
    info, seen = tracks.info, tracks.without_carrier()
    _, first = np.unique(seen.track, return_index=True)
    counts = np.bincount(seen.label[first], minlength=len(CLASSES))
    users = ", ".join(f"{count} {name}" for count, name in zip(counts.tolist(), CLASSES, strict=True) if count)
    laser = next(iter(info.lasers.values()))
    carried = "stands" if info.carrier is None else "drives" if info.carrier.odometry is None else "drives by odometry"
    return f"{users or 'nobody'}; a laser {carried}: {info.rate_hz:g} Hz, {laser.beams} beams to {laser.range_max:g} m"


def simulate_world(seed: int, minutes: float) -> Tracks:
    """The world of a seed; same seed and minutes, same tracks.

    Raises ConfigurationError for invalid minutes, SimulationError where no attempt gives a place to walk in.
    """
    if not 0.0 < minutes <= MAX_WORLD_MINUTES:
        raise ConfigurationError(f"{minutes:g} minutes: expected more than 0 and at most {MAX_WORLD_MINUTES:g}")
    kind = kind_of(seed)
    for attempt in range(ATTEMPTS):
        random = np.random.default_rng([SEED_DOMAIN, seed, attempt])
        scenery = (INDOORS | OUTDOORS)[kind](random)
        if scenery.walkable().area > 6.0:
            return _recorded(scenery, seed, minutes, kind, random)
    raise SimulationError(f"world {seed}: no place to walk in after {ATTEMPTS} attempts; take another seed")


def _recorded(scenery: Scenery, seed: int, minutes: float, kind: str, random: np.random.Generator) -> Tracks:
    """People and a laser in the place."""
    sensor = draw_sensor(random, kind in OUTDOORS)
    frames = max(round(minutes * 60.0 * sensor.rate_hz), 1)
    seconds = RUN_IN_S + minutes * 60.0 + AFTER_S
    drives = bool(random.random() < DRIVING)
    pose = None if drives else _stand(scenery, sensor, random)
    movers = _people(scenery, pose, seconds, random)
    odometry = None
    carrier = None
    if pose is None:
        carrier, pose = 0, straight_view(movers[0].path)
        if random.random() < 0.5:
            odometry = WheelOdometry(seed=seed).scaled(round(float(random.uniform(0.3, 2.0)), 2))
    movers += _sitting(scenery, sensor.plane_m, seconds, random)
    recording = RecordingInfo(
        site=f"world-{seed}",
        classes=CLASSES,
        rate_hz=sensor.rate_hz,
        licence=WORLD_LICENCE,
        credit="simulated with JuPedSim",
        command=world_command(seed, minutes),
    )
    view = WorldView(sensor, pose, carrier, odometry)
    made_with = {"jupedsim": version("jupedsim")}
    return compose(recording, scenery.at(sensor.plane_m), movers, view, frames, seed, made_with)


def _stand(scenery: Scenery, sensor: WorldSensor, random: np.random.Generator) -> SE2:
    """Where the laser stands."""
    outlines: list[Outline] = [np.array(thing.corners, np.float32) for thing in scenery.at(sensor.plane_m)]
    planner = Planner(scenery.walkable(), scenery.inside, [], random)
    return standing_pose(sensor, outlines, [planner.anywhere() for _ in range(16)], random)


def _people(scenery: Scenery, pose: SE2 | None, seconds: float, random: np.random.Generator) -> list[Mover]:
    """Those who walk; where the laser has no `pose`, the first is the robot that carries it."""
    standing: list[Corner] = [] if pose is None else [(pose.x, pose.y)]
    ground = scenery.walkable(*standing)
    planner = Planner(ground, scenery.inside, scenery.doors, random)
    number = int(np.clip(ground.area / random.uniform(4.0, 25.0), 3, 18))
    plans = planner.plans(number, seconds)
    robots = [] if pose is not None else [robot_plan(planner, random)]
    paths = walk(ground, [*robots, *plans], seconds, random)
    movers = []
    for k, path in enumerate(paths):
        walker = build(random)
        size_m = ROBOT_SIZE_M if k < len(robots) else torso(walker, random)
        if path is not None:
            movers.append(Mover(_from_start(path), "pedestrian", size_m, walker))
    return movers


def _sitting(scenery: Scenery, plane_m: float, seconds: float, random: np.random.Generator) -> list[Mover]:
    """Those who sit: their shins are before the seat."""
    movers = []
    ahead_m = 0.28 if plane_m < 0.5 else 0.0
    steps = math.ceil(seconds / CROWD_STEP_S)
    for x, y, heading in scenery.seats:
        walker = build(random).model_copy(update={"companion": "nothing"})
        at = (x + ahead_m * math.cos(heading), y + ahead_m * math.sin(heading))
        if random.random() < SITTING:
            path = MoverPath(0, np.tile(at, (steps, 1)), np.full(steps, heading))
            movers.append(Mover(_from_start(swaying(path, random)), "pedestrian", torso(walker, random), walker))
    return movers


def _from_start(path: MoverPath) -> MoverPath:
    """The path with step 0 at the recording's first frame."""
    return MoverPath(path.first - round(RUN_IN_S / CROWD_STEP_S), path.position, path.heading)
