"""Street networks of unlike shape by SUMO's netgenerate, the traffic on them, and the ground that streets cover."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from gridtrack.simulation.junction.demand import road_user_types
from gridtrack.simulation.sumo import SimulationError, sumo_program

FAR_M = 28.0
"""Road users come from and go to streets this far from the middle."""
BY_M = 12.0
"""The ways of road users lead that near by the middle."""
PAIRS = {"car": 8, "bus": 2, "cyclist": 6, "pedestrian": 12}
"""Pairs of origin and destination of each class."""
VEHICLE_CLASSES = {"car": "passenger", "bus": "bus", "cyclist": "bicycle"}


class StreetNetwork:
    """A network that was generated from random numbers, with its streets as SUMO reads them."""

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
        """What lanes, pavements and junctions cover."""
        parts = [
            shapely.LineString(lane.getShape()).buffer(lane.getWidth() / 2.0, cap_style="flat")
            for edge in self.edges
            for lane in edge.getLanes()
        ]
        nodes = sorted(self._net.getNodes(), key=lambda node: node.getID())
        parts += [shapely.Polygon(node.getShape()) for node in nodes if len(node.getShape()) > 2]
        return shapely.union_all([part.buffer(0.05) for part in parts])

    def middle(self, crossing: bool) -> NDArray[np.float64]:
        """The junction with the most streets, nearest to the middle; else half-way to its nearest neighbour."""
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
        """Road users between far streets, in the XML of SUMO. Raises SimulationError where there are no far streets."""
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
        """Streets between which a class can travel, by way of the middle; people walk as cars drive."""
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
    """A grid with displaced nodes, a spider's web or a random network."""
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
