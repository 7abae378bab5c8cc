"""Streets and crossings: a random network, its traffic by SUMO, houses, and a laser."""

from __future__ import annotations

import math
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely
import shapely.affinity
from numpy.typing import NDArray
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from gridtrack.common.geometry import SE2
from gridtrack.common.scene import Outline
from gridtrack.simulation.junction import pedestrian_poses, vehicle_poses
from gridtrack.simulation.junction.road_users import ROAD_USER_TYPES, road_user_types
from gridtrack.simulation.motion import unbroken_tracks
from gridtrack.simulation.sumo import STEP_S, Movements, SimulationError, run_sumo, sumo_program
from gridtrack.simulation.worlds.compose import Mover, WorldView, straight_view
from gridtrack.simulation.worlds.crowd import CROWD_STEP_S, MoverPath
from gridtrack.simulation.worlds.furniture import leaves, small_thing, tree
from gridtrack.simulation.worlds.outdoors import random_point
from gridtrack.simulation.worlds.people import DRIVING, build, odometry
from gridtrack.simulation.worlds.scenery import Scenery, wall
from gridtrack.simulation.worlds.sensors import WorldSensor, standing_pose

FAR_M = 28.0
"""Minimum distance of origins and destinations from the middle."""
BY_M = 12.0
"""Maximum distance at which routes pass the middle."""
PAIRS = {"car": 8, "bus": 2, "cyclist": 6, "pedestrian": 12}
"""Number of origin-destination pairs of each class."""
VEHICLE_CLASSES = {"car": "passenger", "bus": "bus", "cyclist": "bicycle"}
FILLING_S, STREET_MARGIN_S = 60.0, 3.0
"""Time from empty streets to traffic, and the time simulated before and after the recording for the smoothing."""
USERS_PER_SECOND = {"car": (0.08, 0.45), "bus": (0.0, 0.04), "cyclist": (0.04, 0.25), "pedestrian": (0.15, 0.5)}
MODELLED_M = 70.0
"""Radius around the middle with houses."""
BESIDE_M = (0.3, 2.0)
"""Minimum distance of a standing laser from objects, and maximum distance from the streets."""
FREE_M = 0.6
LEAST_MOVED_M = 5.0


class StreetNetwork:
    """A random street network."""

    def __init__(self, folder: Path, random: np.random.Generator) -> None:
        self.path = folder / "network.net.xml"
        shape = _shape_options(random)
        common = [
            "--sidewalks.guess",
            "--crossings.guess",
            "--no-turnarounds",
            f"--default.sidewalk-width={random.uniform(1.8, 3.5):.2f}",
            f"--default.lanewidth={random.uniform(3.0, 4.0):.2f}",
            f"--default.speed={random.uniform(6.0, 13.0):.2f}",
            f"--default.lanenumber={random.choice([1, 1, 1, 2])}",
            f"--default.junctions.radius={random.uniform(2.5, 7.0):.2f}",
            f"--default-junction-type={random.choice(['priority', 'right_before_left', 'traffic_light'])}",
            f"--seed={random.integers(1 << 30)}",
            "--no-warnings",
        ]
        command = [str(sumo_program("netgenerate")), *shape, *common, f"--output-file={self.path}"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise SimulationError(f"netgenerate failed: {done.stderr.strip().splitlines()[:1]}")
        from sumolib.net import readNet

        self._net = readNet(str(self.path), withPedestrianConnections=True)
        self.edges: list[Any] = sorted(self._net.getEdges(withInternal=False), key=lambda edge: edge.getID())

    def ground(self) -> BaseGeometry:
        """The area of lanes, pavements and junctions."""
        parts = [
            shapely.LineString(lane.getShape()).buffer(lane.getWidth() / 2.0, cap_style="flat")
            for edge in self.edges
            for lane in edge.getLanes()
        ]
        nodes = sorted(self._net.getNodes(), key=lambda node: node.getID())
        parts += [shapely.Polygon(node.getShape()) for node in nodes if len(node.getShape()) > 2]
        return shapely.union_all([part.buffer(0.05) for part in parts])

    def middle(self, crossing: bool) -> NDArray[np.float64]:
        """The most central of the junctions with the most streets, or half-way from it to its nearest neighbour."""
        nodes = sorted(self._net.getNodes(), key=lambda node: node.getID())
        places: NDArray[np.float64] = np.array([node.getCoord()[:2] for node in nodes])
        streets = np.array([min(len(node.getIncoming()), 3) for node in nodes])
        centre = places.mean(axis=0)
        first = np.lexsort((np.hypot(*(places - centre).T), -streets))[0]
        at: NDArray[np.float64] = places[first]
        if crossing:
            return at
        others = sorted({edge.getToNode().getID() for edge in nodes[first].getOutgoing()})
        ends = np.array([self._net.getNode(name).getCoord()[:2] for name in others])
        nearest: NDArray[np.float64] = ends[np.hypot(*(ends - at).T).argmin()]
        return (at + nearest) / 2.0

    def demand(self, per_second: dict[str, float], middle: NDArray[np.float64], random: np.random.Generator) -> str:
        """The demand between far streets as SUMO's XML. Raises SimulationError without far streets."""
        far = [edge for edge in self.edges if _distance(edge, middle) > FAR_M]
        if len(far) < 4:
            raise SimulationError("a network without streets further away")
        lines = ["<routes>", *road_user_types()]
        for label, pairs in PAIRS.items():
            found = self._pairs(far, label, pairs, middle, random)
            for k, (origin, end) in enumerate(found):
                lines.append(_flow(label, k, origin.getID(), end.getID(), per_second[label] / len(found)))
        return "\n".join([*lines, "</routes>\n"])

    def _pairs(
        self, far: Sequence[Any], label: str, pairs: int, middle: NDArray[np.float64], random: np.random.Generator
    ) -> list[tuple[Any, Any]]:
        """Pairs of streets with a route of a class past the middle; pedestrians use the routes of cars."""
        found: list[tuple[Any, Any]] = []
        for _ in range(pairs * 12):
            one, other = (far[k] for k in random.integers(len(far), size=2))
            if one is other or len(found) == pairs:
                continue
            way = self._net.getShortestPath(one, other, vClass=VEHICLE_CLASSES.get(label, "passenger"))[0]
            if way is not None and min(_distance(edge, middle) for edge in way) < BY_M:
                found.append((one, other))
        return found


def _shape_options(random: np.random.Generator) -> list[str]:
    """Options for a grid with displaced nodes, a spider network or a random network."""
    kind = random.integers(3)
    if kind == 0:
        length_m = random.uniform(45.0, 80.0)
        return [
            "--grid",
            f"--grid.number={random.integers(2, 4)}",
            f"--grid.length={length_m:.1f}",
            f"--grid.attach-length={random.uniform(40.0, 70.0):.1f}",
            f"--perturb-x=uniform(-{length_m / 6.0:.1f},{length_m / 6.0:.1f})",
            f"--perturb-y=uniform(-{length_m / 6.0:.1f},{length_m / 6.0:.1f})",
        ]
    if kind == 1:
        return [
            "--spider",
            f"--spider.arm-number={random.integers(3, 7)}",
            "--spider.circle-number=2",
            f"--spider.space-radius={random.uniform(45.0, 70.0):.1f}",
        ]
    return [
        "--rand",
        f"--rand.iterations={random.integers(10, 16)}",
        "--rand.min-distance=45",
        "--rand.max-distance=90",
        "--rand.bidi-probability=1",
        "--rand.min-angle=50",
    ]


def _distance(edge: Any, middle: NDArray[np.float64]) -> float:
    return float(shapely.LineString(edge.getShape()).distance(shapely.Point(middle)))


def _flow(label: str, number: int, origin: str, end: str, per_second: float) -> str:
    """Road users at random times between two streets."""
    period = f'begin="0" end="3600" period="exp({max(per_second, 1e-4):.6f})"'
    if label == "pedestrian":
        return (
            f'<personFlow id="{label}{number}" type="{label}" {period} departPosLat="random" departPos="random">'
            f'<walk from="{origin}" to="{end}" arrivalPos="random"/></personFlow>'
        )
    return (
        f'<flow id="{label}{number}" type="{label}" {period} from="{origin}" to="{end}" departLane="best"'
        ' departSpeed="desired"/>'
    )


class PassiveObserver:
    """Does not act on the traffic."""

    every_s = 20.0

    def start(self, traffic: Any) -> None:
        """Does nothing."""

    def observe(self, traffic: Any) -> None:
        """Does nothing."""


def streets(
    crossing: bool, sensor: WorldSensor, seconds: float, seed: int, random: np.random.Generator
) -> tuple[Scenery, list[Mover], WorldView]:
    """A crossing or a street between two crossings, its traffic for `seconds`, and a laser.

    Raises SimulationError if there is no traffic, or no free place for a laser.
    """
    span_s = (FILLING_S - STREET_MARGIN_S, FILLING_S + seconds + STREET_MARGIN_S)
    with tempfile.TemporaryDirectory() as folder:
        network = StreetNetwork(Path(folder), random)
        middle = network.middle(crossing)
        rates = {label: float(random.uniform(*ends)) for label, ends in USERS_PER_SECOND.items()}
        demand = network.demand(rates, middle, random)
        movements = run_sumo(
            Path(folder), network.path, demand, (), span_s, int(random.integers(1 << 30)), PassiveObserver()
        )
        ground = network.ground()
    movers = _movers(movements, random)
    scenery = _scenery(ground, middle, random)
    if random.random() < DRIVING:
        carrier = _carrier(movers, middle, seconds)
        view = WorldView(sensor, straight_view(movers[carrier].path), carrier, odometry(seed, 0.4, random))
    else:
        view = WorldView(sensor, _beside(scenery, ground, movers, middle, sensor, random))
    return scenery, movers, view


def _movers(movements: Movements, random: np.random.Generator) -> list[Mover]:
    """The road users, with step 0 at the first frame of the recording."""
    found = []
    for rows in unbroken_tracks(movements.user, movements.step):
        kind = ROAD_USER_TYPES[movements.kind[movements.user[rows.start]]]
        if rows.stop - rows.start < 8:
            continue
        walks = kind.label == "pedestrian"
        poses = pedestrian_poses(movements, rows) if walks else vehicle_poses(movements, rows, kind)
        times = movements.step[rows] * STEP_S - STREET_MARGIN_S
        first, last = math.ceil(times[0] / CROWD_STEP_S), math.floor(times[-1] / CROWD_STEP_S)
        at = np.arange(first, last + 1) * CROWD_STEP_S
        x, y, heading = (np.interp(at, times, column) for column in (*poses.T[:2], np.unwrap(poses[:, 2])))
        path = MoverPath(first, np.column_stack([x, y]), heading)
        found.append(Mover(path, kind.label, (kind.length_m, kind.width_m), build(random) if walks else None))
    return found


def _scenery(ground: BaseGeometry, middle: NDArray[np.float64], random: np.random.Generator) -> Scenery:
    """Houses, front gardens, and objects at the edge of the pavement."""
    area = shapely.Point(middle).buffer(MODELLED_M)
    scenery = Scenery(area)
    blocks = area.difference(ground.buffer(random.uniform(0.2, 2.0)))
    for lot in _lots(blocks, middle, random):
        kind = random.random()
        if kind < 0.75:
            house = lot.buffer(-random.choice([0.0, 0.05, 0.4, 1.5]), join_style="mitre").simplify(0.05)
            for part in getattr(house, "geoms", [house]):
                if part.area > 4.0:
                    scenery.add(list(part.exterior.coords)[:-1])
        else:
            for _ in range(random.poisson(lot.area / 25.0)):
                x, y = random_point(lot, random)
                if random.random() < 0.5:
                    tree(scenery, x, y, random)
                else:
                    leaves(scenery, x, y, random.uniform(0.3, 1.0), random)
    _pavement_edge(scenery, ground, random)
    # no things where road users move
    scenery.things = [thing for thing in scenery.things if not Polygon(thing.corners).intersects(ground)]
    return scenery


def _pavement_edge(scenery: Scenery, ground: BaseGeometry, random: np.random.Generator) -> None:
    """Posts, trees, low walls and fences along the streets."""
    edge = ground.buffer(0.4).intersection(scenery.inside.buffer(-20.0)).boundary
    spacing_m = random.uniform(4.0, 10.0)
    for along in np.arange(0.0, edge.length, spacing_m):
        if random.random() < 0.6:
            at = edge.interpolate(along + random.uniform(-2.0, 2.0))
            kind, end = random.random(), edge.interpolate(along + random.uniform(2.0, 7.0))
            if kind < 0.35:
                tree(scenery, at.x, at.y, random)
            elif kind < 0.65:
                small_thing(scenery, at.x, at.y, random.uniform(0.0, math.tau), random)
            elif 1.0 < math.dist((at.x, at.y), (end.x, end.y)) < 8.0:
                wall(scenery, (at.x, at.y), (end.x, end.y), random.choice([0.05, 0.25]))


def _lots(blocks: BaseGeometry, middle: NDArray[np.float64], random: np.random.Generator) -> list[Polygon]:
    """The blocks divided into lots by a rotated grid."""
    turned = random.uniform(0.0, math.pi / 2)
    sides = random.uniform(7.0, 18.0, 2)
    found = []
    ends = [np.arange(-MODELLED_M, MODELLED_M, side) for side in sides]
    for x in ends[0]:
        for y in ends[1]:
            cell = shapely.box(x, y, x + sides[0], y + sides[1])
            cell = shapely.affinity.rotate(cell, turned, origin=(0, 0), use_radians=True)
            lot = shapely.affinity.translate(cell, *middle).intersection(blocks)
            found += [part for part in getattr(lot, "geoms", [lot]) if isinstance(part, Polygon) and part.area > 4.0]
    return found


def _carrier(movers: list[Mover], middle: NDArray[np.float64], seconds: float) -> int:
    """The pedestrian who is present all the time, moves, and passes nearest to the middle: replaced by a robot."""
    steps = math.ceil(seconds / CROWD_STEP_S)
    best, best_m = -1, math.inf
    for number, mover in enumerate(movers):
        path = mover.path
        if mover.label != "pedestrian" or path.first > 0 or path.first + len(path.heading) <= steps:
            continue
        recorded = path.position[-path.first : -path.first + steps]
        moved_m = float(np.hypot(*(recorded[-1] - recorded[0])))
        nearest_m = float(np.hypot(*(recorded - middle).T).min())
        if moved_m > LEAST_MOVED_M and nearest_m < best_m:
            best, best_m = number, nearest_m
    if best < 0:
        raise SimulationError("no pedestrian is present all the time")
    return best


def _beside(
    scenery: Scenery,
    ground: BaseGeometry,
    movers: list[Mover],
    middle: NDArray[np.float64],
    sensor: WorldSensor,
    random: np.random.Generator,
) -> SE2:
    """The pose of a laser at the edge of the streets, near the middle, clear of all road users."""
    outlines: list[Outline] = [np.array(thing.corners, np.float32) for thing in scenery.at(sensor.plane_m)]
    solid = shapely.union_all([Polygon(outline) for outline in outlines])
    everywhere = np.concatenate([mover.path.position for mover in movers])
    half_m = np.concatenate([np.full(len(mover.path.heading), mover.size_m[0] / 2.0) for mover in movers])
    places: list[tuple[float, float]] = []
    ring = ground.buffer(BESIDE_M[1]).intersection(shapely.Point(middle).buffer(11.0))
    for _ in range(300):
        x, y = random_point(ring, random)
        clear = (np.hypot(*(everywhere - (x, y)).T) > half_m + FREE_M).all()
        if clear and solid.distance(shapely.Point(x, y)) > BESIDE_M[0]:
            places.append((x, y))
        if len(places) == 16:
            break
    if not places:
        raise SimulationError("no place is free for a laser")
    return standing_pose(sensor, outlines, places, random)
