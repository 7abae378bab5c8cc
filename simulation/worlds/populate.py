"""Who is in a place on foot: those who walk, sit, ride through and park, and the laser that watches them."""

from __future__ import annotations

import math

import numpy as np
import shapely

from gridtrack.common.geometry import SE2
from gridtrack.common.scene import Outline
from gridtrack.simulation.odometry import WheelOdometry
from gridtrack.simulation.sumo import SimulationError
from gridtrack.simulation.tracks import Corner
from gridtrack.simulation.worlds.compose import Mover, WorldView, straight_view
from gridtrack.simulation.worlds.crowd import CROWD_STEP_S, MoverPath, swaying, walk
from gridtrack.simulation.worlds.plans import Planner, build, robot_plan, torso
from gridtrack.simulation.worlds.scenery import Scenery, box
from gridtrack.simulation.worlds.sensors import WorldSensor, standing_pose
from gridtrack.simulation.worlds.street_furniture import BICYCLE_SIZE_M, CAR_SIZES_M
from gridtrack.simulation.worlds.vehicles import ride, standing_still

RUN_IN_S, AFTER_S = 10.0, 1.0
"""Simulated before and after the recording."""
DRIVING, BY_ODOMETRY = 0.35, 0.5
"""Share of worlds whose laser drives, and of these that record the poses of wheel odometry."""
ROBOT_SIZE_M = (0.5, 0.45)
SITTING = 0.5
MOST_PEOPLE = 30
LANE_CLEARANCE_M = 1.5
"""Between a laser that stands and the middle of a lane."""


def on_foot(
    scenery: Scenery, sensor: WorldSensor, seconds: float, seed: int, random: np.random.Generator
) -> tuple[list[Mover], WorldView]:
    """Who moves during `seconds` from step 0 on, and what watches. Raises SimulationError where there is no room."""
    if scenery.walkable().area < 6.0:
        raise SimulationError("no place to walk in")
    whole_s = RUN_IN_S + seconds + AFTER_S
    standing = None if random.random() < DRIVING else _stand(scenery, sensor, random)
    movers = _people(scenery, standing, whole_s, random)
    movers += _sitting(scenery, sensor.plane_m, whole_s, random)
    movers += _parked(scenery, whole_s)
    movers += _riding(scenery, movers, whole_s, random)
    movers = [Mover(from_start(mover.path), mover.label, mover.size_m, mover.walker) for mover in movers]
    if standing is not None:
        return movers, WorldView(sensor, standing)
    return movers, WorldView(sensor, straight_view(movers[0].path), 0, odometry(seed, 0.4, random))


def odometry(seed: int, track_width_m: float, random: np.random.Generator) -> WheelOdometry | None:
    """Errors of wheel odometry of various sizes, or none."""
    if random.random() >= BY_ODOMETRY:
        return None
    return WheelOdometry(seed=seed, track_width_m=track_width_m).scaled(round(float(random.uniform(0.3, 2.0)), 2))


def from_start(path: MoverPath) -> MoverPath:
    """The path with step 0 at the recording's first frame."""
    return MoverPath(path.first - round(RUN_IN_S / CROWD_STEP_S), path.position, path.heading)


def _stand(scenery: Scenery, sensor: WorldSensor, random: np.random.Generator) -> SE2:
    """Where the laser stands: where people could walk, off the lanes."""
    outlines: list[Outline] = [np.array(thing.corners, np.float32) for thing in scenery.at(sensor.plane_m)]
    outlines += [np.array(box(p.pose.x, p.pose.y, *p.size_m, p.pose.theta), np.float32) for p in scenery.parked]
    planner = Planner(scenery.walkable(), scenery.inside, [], random)
    lanes = shapely.union_all([shapely.LineString(lane.way) for lane in scenery.lanes])
    places = [planner.anywhere() for _ in range(24)]
    off_lanes = [at for at in places if lanes.is_empty or lanes.distance(shapely.Point(at)) > LANE_CLEARANCE_M]
    return standing_pose(sensor, outlines, off_lanes or places, random)


def _people(scenery: Scenery, standing: SE2 | None, seconds: float, random: np.random.Generator) -> list[Mover]:
    """Those who walk; where no laser is `standing`, the first is the robot that carries it."""
    at: list[Corner] = [] if standing is None else [(standing.x, standing.y)]
    ground = scenery.walkable(*at)
    planner = Planner(ground, scenery.inside, scenery.doors, random)
    number = int(np.clip(ground.area / random.uniform(4.0, 22.0), 3, MOST_PEOPLE))
    plans = planner.plans(number, seconds)
    robots = [robot_plan(planner, random)] if standing is None else []
    movers = []
    for k, path in enumerate(walk(ground, [*robots, *plans], seconds, random)):
        walker = build(random)
        if path is None and k < len(robots):
            raise SimulationError("no room for the robot")
        if path is not None:
            size_m = ROBOT_SIZE_M if k < len(robots) else torso(walker, random)
            movers.append(Mover(path, "pedestrian", size_m, walker))
    return movers


def _sitting(scenery: Scenery, plane_m: float, seconds: float, random: np.random.Generator) -> list[Mover]:
    """Those who sit: their shins are before the seat."""
    movers = []
    ahead_m = 0.28 if plane_m < 0.5 else 0.0
    for x, y, heading in scenery.seats:
        walker = build(random).model_copy(update={"companion": "nothing"})
        at = (x + ahead_m * math.cos(heading), y + ahead_m * math.sin(heading))
        if random.random() < SITTING:
            path = swaying(standing_still(*at, heading, seconds), random)
            movers.append(Mover(path, "pedestrian", torso(walker, random), walker))
    return movers


def _parked(scenery: Scenery, seconds: float) -> list[Mover]:
    return [
        Mover(standing_still(one.pose.x, one.pose.y, one.pose.theta, seconds), one.label, one.size_m)
        for one in scenery.parked
    ]


def _riding(scenery: Scenery, present: list[Mover], seconds: float, random: np.random.Generator) -> list[Mover]:
    """Vehicles on the clear lanes, each giving way to those who are there."""
    movers: list[Mover] = []
    others = [mover.path for mover in present]
    for lane in scenery.lanes:
        for start_s in np.sort(random.uniform(0.0, seconds - 5.0, int(random.integers(1, 5)))) if lane.clear else ():
            car = lane.label == "car"
            size_m = CAR_SIZES_M[random.integers(len(CAR_SIZES_M))] if car else BICYCLE_SIZE_M
            path = ride(lane.way, size_m, lane.speed * random.uniform(0.8, 1.2), float(start_s), others, seconds)
            if path is not None:
                movers.append(Mover(path, lane.label, size_m))
                others += _ends(path, size_m[0])
    return movers


def _ends(path: MoverPath, length_m: float) -> list[MoverPath]:
    """Middle, front and rear of a vehicle."""
    ahead = length_m / 2.0 * np.column_stack([np.cos(path.heading), np.sin(path.heading)])
    return [MoverPath(path.first, path.position + share * ahead, path.heading) for share in (-1.0, 0.0, 1.0)]
