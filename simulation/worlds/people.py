"""The people in a place: builds, plans, and the paths of everybody who walks, sits, parks or rides."""

from __future__ import annotations

import math

import numpy as np
import shapely
from shapely import Polygon

from gridtrack.common.geometry import SE2
from gridtrack.common.scene import Outline
from gridtrack.simulation.bodies import Companion, Walker
from gridtrack.simulation.motion import WheelOdometry
from gridtrack.simulation.sumo import SimulationError
from gridtrack.simulation.tracks import Corner
from gridtrack.simulation.worlds.compose import Mover, WorldView, straight_view
from gridtrack.simulation.worlds.crowd import CROWD_STEP_S, MoverPath, Plan, Stop, swaying, walk
from gridtrack.simulation.worlds.furniture import BICYCLE_SIZE_M, CAR_SIZES_M
from gridtrack.simulation.worlds.scenery import Scenery, box
from gridtrack.simulation.worlds.sensors import WorldSensor, standing_pose
from gridtrack.simulation.worlds.vehicles import ride, standing_still

WALKING_M_S = (1.2, 0.25)
"""Mean and standard deviation of the preferred speed of adults: slower than 1.34 m/s (U. Weidmann, "Transporttechnik
der
Fussgänger", 1993) because these places are small."""
COMPANIONS: dict[Companion, float] = {
    "nothing": 0.68,
    "bag": 0.12,
    "coat": 0.1,
    "trolley": 0.05,
    "stroller": 0.03,
    "wheelchair": 0.02,
}
BEHAVIOURS = {"pass": 0.3, "wander": 0.3, "stand": 0.12, "group": 0.14, "turn": 0.07, "pace": 0.07}
RUN_IN_S, AFTER_S = 10.0, 1.0
"""Simulated before and after the recording."""
DRIVING, BY_ODOMETRY = 0.35, 0.5
"""Share of worlds with a driving laser, and of these with poses from wheel odometry."""
ROBOT_SIZE_M = (0.5, 0.45)
SITTING = 0.5
MOST_PEOPLE = 30
LANE_CLEARANCE_M = 1.5
"""Minimum distance of a standing laser from the middle of a lane."""


def build(random: np.random.Generator) -> Walker:
    """A random build; one in eight is a child."""
    child = random.random() < 0.12
    height_m = random.uniform(1.0, 1.5) if child else float(np.clip(random.normal(1.71, 0.1), 1.5, 2.0))
    companion: Companion = "nothing" if child else str(random.choice([*COMPANIONS], p=[*COMPANIONS.values()]))  # type: ignore[assignment]
    return Walker(
        height_m=round(height_m, 2),
        apart_m=round(height_m * random.uniform(0.06, 0.12), 3),
        companion=companion,
        dark=bool(random.random() < 0.15),
        phase=round(random.uniform(0.0, 1.0), 3),
    )


def torso(walker: Walker, random: np.random.Generator) -> tuple[float, float]:
    """Length and width of a body at the chest, metres."""
    share = walker.height_m / 1.72
    return float(random.uniform(0.2, 0.3) * share), float(random.uniform(0.38, 0.52) * share)


class Planner:
    """Draws plans for a place: stops are on `ground` and `inside`; people come and go by `doors`."""

    def __init__(self, ground: Polygon, inside: Polygon, doors: list[Corner], random: np.random.Generator) -> None:
        self._inside = ground.buffer(-0.25).intersection(inside)
        self._doors, self._random = doors, random
        self._bounds = ground.bounds

    def anywhere(self) -> Corner:
        """A random place."""
        x0, y0, x1, y1 = self._bounds
        for _ in range(500):
            at = shapely.Point(self._random.uniform(x0, x1), self._random.uniform(y0, y1))
            if self._inside.contains(at):
                break
        return (at.x, at.y)

    def plans(self, people: int, seconds: float) -> list[Plan]:
        """Plans for about `people` people at a time."""
        found: list[Plan] = []
        while len(found) < people:
            behaviour = str(self._random.choice([*BEHAVIOURS], p=[*BEHAVIOURS.values()]))
            found += self._group() if behaviour == "group" else self._together(behaviour, seconds)
        return found

    def _together(self, behaviour: str, seconds: float) -> list[Plan]:
        """Plans of one person, or of two or three who walk side by side."""
        random = self._random
        companions = int(random.choice([1, 2, 3], p=[0.75, 0.2, 0.05])) if behaviour in ("pass", "wander") else 1
        speed = float(np.clip(random.normal(*WALKING_M_S), 0.5, 1.9))
        start_s = 0.0
        leaves = False
        if behaviour == "pass":
            ends = [
                self._doors[k] if self._doors else self.anywhere()
                for k in random.integers(max(len(self._doors), 1), size=2)
            ]
            start, start_s, leaves = ends[0], float(random.uniform(0.0, seconds)), True
            stops = [
                *([Stop(self.anywhere(), self._while())] if random.random() < 0.4 or ends[0] == ends[1] else []),
                Stop(ends[1]),
            ]
        elif behaviour == "stand":
            start = self.anywhere()
            stops = [
                Stop(start, float(random.uniform(5.0, 40.0)), float(random.uniform(-math.pi, math.pi)))
                for _ in range(4)
            ]
        elif behaviour == "wander":
            start = self.anywhere()
            stops = [Stop(self.anywhere(), self._while(), self._look()) for _ in range(6)]
        else:
            start, far = self.anywhere(), self.anywhere()
            pause_s = float(random.uniform(0.2, 1.5)) if behaviour == "turn" else self._while()
            stops = [Stop(far, pause_s), Stop(start, pause_s)]
        aside = [(0.0, 0.0), (0.55, 0.2), (-0.45, 0.45)]
        return [
            Plan(
                _by(start, aside[k]),
                tuple(Stop(_by(s.at, aside[k]), s.wait_s, s.facing) for s in stops),
                speed,
                0.17,
                start_s,
                leaves,
            )
            for k in range(companions)
        ]

    def _group(self) -> list[Plan]:
        """Plans of people who stand in a circle and talk; some leave later."""
        random = self._random
        (x, y), size = self.anywhere(), int(random.integers(2, 5))
        radius_m, turned = random.uniform(0.45, 0.8), random.uniform(0.0, math.tau)
        found = []
        for k in range(size):
            angle = turned + math.tau * k / size + random.normal(0.0, 0.15)
            at = (x + radius_m * math.cos(angle), y + radius_m * math.sin(angle))
            stops = [Stop(at, float(random.uniform(10.0, 90.0)), angle + math.pi)]
            if random.random() < 0.5:
                stops.append(Stop(self.anywhere(), self._while(), self._look()))
            found.append(Plan(at, tuple(stops), float(random.uniform(0.7, 1.3)), 0.16))
        return found

    def _while(self) -> float:
        """The duration of a stay, often 0."""
        return float(self._random.exponential(6.0)) if self._random.random() < 0.6 else 0.0

    def _look(self) -> float | None:
        return float(self._random.uniform(-math.pi, math.pi)) if self._random.random() < 0.5 else None


def robot_plan(planner: Planner, random: np.random.Generator) -> Plan:
    """The plan of a robot that drives, stops, and turns on the spot."""
    look = [float(random.uniform(-math.pi, math.pi)) if random.random() < 0.5 else None for _ in range(12)]
    stops = tuple(Stop(planner.anywhere(), float(random.choice([0.0, 2.0, 5.0])), facing) for facing in look)
    return Plan(planner.anywhere(), stops, float(random.uniform(0.3, 0.9)), 0.28)


def _by(at: Corner, offset: Corner) -> Corner:
    return (at[0] + offset[0], at[1] + offset[1])


def on_foot(
    scenery: Scenery, sensor: WorldSensor, seconds: float, seed: int, random: np.random.Generator
) -> tuple[list[Mover], WorldView]:
    """The road users of a place for `seconds` from step 0, and its sensor. Raises SimulationError without room."""
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
    """Wheel odometry with errors of a random size, or None."""
    if random.random() >= BY_ODOMETRY:
        return None
    return WheelOdometry(seed=seed, track_width_m=track_width_m).scaled(round(float(random.uniform(0.3, 2.0)), 2))


def from_start(path: MoverPath) -> MoverPath:
    """The path with step 0 at the first frame of the recording."""
    return MoverPath(path.first - round(RUN_IN_S / CROWD_STEP_S), path.position, path.heading)


def _stand(scenery: Scenery, sensor: WorldSensor, random: np.random.Generator) -> SE2:
    """The pose of a standing laser on the walkable ground off the lanes."""
    outlines: list[Outline] = [np.array(thing.corners, np.float32) for thing in scenery.at(sensor.plane_m)]
    outlines += [np.array(box(p.pose.x, p.pose.y, *p.size_m, p.pose.theta), np.float32) for p in scenery.parked]
    planner = Planner(scenery.walkable(), scenery.inside, [], random)
    lanes = shapely.union_all([shapely.LineString(lane.way) for lane in scenery.lanes])
    places = [planner.anywhere() for _ in range(24)]
    off_lanes = [at for at in places if lanes.is_empty or lanes.distance(shapely.Point(at)) > LANE_CLEARANCE_M]
    return standing_pose(sensor, outlines, off_lanes or places, random)


def _people(scenery: Scenery, standing: SE2 | None, seconds: float, random: np.random.Generator) -> list[Mover]:
    """Walking people; if no laser is `standing`, the first mover is the robot that carries it."""
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
    """Sitting people: at shin height they are in front of the seat."""
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
    """Vehicles on the clear lanes; each gives way to everybody before it."""
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
