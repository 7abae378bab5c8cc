"""The scenery of a place: objects, walls, lanes, and the walkable ground."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import Polygon
from shapely.geometry.base import BaseGeometry

from gridtrack.common.geometry import SE2
from gridtrack.simulation.tracks import Corner

Corners = tuple[Corner, ...]
WALKER_CLEARANCE_M = 0.1
"""Minimum distance of walkers from obstacles, besides their radius."""
LASER_FREE_M = 0.35
SIMPLER_M = 0.02
CEILING_M = 3.0
DOOR_M = (0.85, 1.6)
PANE_M = (0.8, 3.0)


@dataclass(frozen=True)
class Thing:
    """A static object: its outline, counter-clockwise, between two heights, and its surface."""

    corners: Corners
    low_m: float = 0.0
    high_m: float = CEILING_M
    glass: bool = False
    dark: bool = False


@dataclass(frozen=True)
class Parked:
    """A road user that does not move: its class, the pose of its centre, its length and width."""

    label: str
    pose: SE2
    size_m: tuple[float, float]


@dataclass(frozen=True)
class Lane:
    """The centre line (n, 2) of a lane, the class of its vehicles and their maximum speed; `clear`: without objects."""

    label: str
    way: NDArray[np.float64]
    speed: float
    clear: bool = True


@dataclass
class Scenery:
    """The content of a place, in metres.

    `inside` is the ground for people and lasers; `thresholds` extend it behind doors; nobody walks on `blocked`. People
    enter and leave by `doors` and may sit on `seats` (x, y, heading); vehicles use `lanes`, and some are `parked`.
    """

    inside: Polygon
    thresholds: list[Polygon] = field(default_factory=list)
    things: list[Thing] = field(default_factory=list)
    blocked: list[BaseGeometry] = field(default_factory=list)
    doors: list[Corner] = field(default_factory=list)
    seats: list[tuple[float, float, float]] = field(default_factory=list)
    lanes: list[Lane] = field(default_factory=list)
    parked: list[Parked] = field(default_factory=list)

    def add(
        self,
        corners: Sequence[Corner],
        *,
        low_m: float = 0.0,
        high_m: float = CEILING_M,
        glass: bool = False,
        dark: bool = False,
        blocks: bool = True,
    ) -> None:
        """Add a thing with a simple outline; if it `blocks`, nobody walks there."""
        outline = counter_clockwise(corners)
        self.things.append(Thing(outline, low_m, high_m, glass, dark))
        if blocks:
            self.block(outline)

    def block(self, corners: Sequence[Corner]) -> None:
        """Exclude the polygon `corners` from the walkable ground."""
        self.blocked.append(Polygon(corners))

    def at(self, plane_m: float) -> list[Thing]:
        """The things that the plane at a height intersects."""
        return [thing for thing in self.things if thing.low_m <= plane_m < thing.high_m]

    def walkable(self, *standing: Corner) -> Polygon:
        """The largest connected walkable ground, without a disc of LASER_FREE_M around each point of `standing`."""
        discs = [shapely.Point(at).buffer(LASER_FREE_M, quad_segs=4) for at in standing]
        solid = shapely.union_all([*self.blocked, *discs]).buffer(WALKER_CLEARANCE_M, quad_segs=2, join_style="mitre")
        area = shapely.union_all([self.inside, *self.thresholds])
        free = area.buffer(-WALKER_CLEARANCE_M).difference(solid).simplify(SIMPLER_M)
        # morphological opening: no parts are connected by a gap too narrow to pass
        free = free.buffer(-0.1, quad_segs=2).buffer(0.09, quad_segs=2, join_style="mitre").simplify(SIMPLER_M)
        return max((part for part in _parts(free) if part.is_valid), key=lambda part: part.area, default=Polygon())


def _parts(geometry: BaseGeometry) -> list[Polygon]:
    if isinstance(geometry, Polygon):
        return [geometry]
    return [part for part in getattr(geometry, "geoms", ()) if isinstance(part, Polygon)]


def counter_clockwise(corners: Sequence[Corner]) -> Corners:
    """The corners in counter-clockwise order."""
    doubled = sum(x0 * y1 - x1 * y0 for (x0, y0), (x1, y1) in zip(corners, [*corners[1:], corners[0]], strict=True))
    ordered = corners if doubled >= 0.0 else reversed(corners)
    return tuple((float(x), float(y)) for x, y in ordered)


def box(x: float, y: float, length_m: float, width_m: float, heading: float = 0.0) -> Corners:
    """A rectangle centred on (x, y) with its length along `heading`."""
    return placed(
        [(a * length_m / 2.0, b * width_m / 2.0) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))], x, y, heading
    )


def disc(x: float, y: float, diameter_m: float, corners: int = 10) -> Corners:
    """A regular polygon in a circle around (x, y)."""
    angles = [2.0 * math.pi * k / corners for k in range(corners)]
    return tuple((x + diameter_m / 2.0 * math.cos(a), y + diameter_m / 2.0 * math.sin(a)) for a in angles)


def placed(corners: Sequence[Corner], x: float, y: float, heading: float) -> Corners:
    """Corners in the world frame, given in the body frame at the pose (x, y, heading)."""
    c, s = math.cos(heading), math.sin(heading)
    return tuple((x + c * a - s * b, y + s * a + c * b) for a, b in corners)


def wall(
    scenery: Scenery,
    start: Corner,
    end: Corner,
    thickness_m: float,
    openings: Sequence[tuple[float, float]] = (),
    glass: Sequence[tuple[float, float]] = (),
) -> None:
    """Add a wall from `start` to `end`, with `openings` and panes of `glass`: (first, last) along the wall, metres."""
    length_m = math.dist(start, end)
    heading = math.atan2(end[1] - start[1], end[0] - start[0])
    cuts = sorted([(a, b, False) for a, b in openings] + [(a, b, True) for a, b in glass])
    at = -thickness_m / 2.0
    for a, b, is_glass in [*cuts, (length_m + thickness_m / 2.0, length_m + thickness_m / 2.0, False)]:
        if a > at:
            scenery.add(_stretch(start, heading, at, a, thickness_m))
        if is_glass:
            scenery.add(_stretch(start, heading, a, b, 0.03), glass=True)
        at = max(at, b)


def _stretch(start: Corner, heading: float, a: float, b: float, thickness_m: float) -> Corners:
    middle = (a + b) / 2.0
    x, y = start[0] + middle * math.cos(heading), start[1] + middle * math.sin(heading)
    return box(x, y, b - a, thickness_m, heading)


def enclose(
    scenery: Scenery, corners: Sequence[Corner], random: np.random.Generator, doors: int, glass: float
) -> list[Corner]:
    """Add walls along all sides of a polygon with `doors` open doors; returns a point behind each door, outside.

    `glass` is the probability that a stretch between doors is a glass pane down to the floor.
    """
    corners = counter_clockwise(corners)
    sides = list(zip(corners, [*corners[1:], corners[0]], strict=True))
    lengths = np.array([math.dist(*side) for side in sides])
    with_door = random.choice(
        len(sides), doors, p=np.where(lengths > 2.5, lengths, 1e-9) / np.where(lengths > 2.5, lengths, 1e-9).sum()
    )
    thickness_m = random.uniform(0.12, 0.35)
    found = []
    for k, (start, end) in enumerate(sides):
        openings: list[tuple[float, float]] = []
        for _ in range(int((with_door == k).sum())):
            opening = _free_stretch(random, lengths[k], random.uniform(*DOOR_M), openings)
            if opening is not None:
                openings.append(opening)
                found.append(threshold(scenery, start, end, opening, random))
                door_leaf(scenery, start, end, opening, random)
        panes: list[tuple[float, float]] = []
        for _ in range(int(lengths[k] / 2.0)):
            pane = _free_stretch(random, lengths[k], random.uniform(*PANE_M), [*openings, *panes])
            if pane is not None and random.random() < glass:
                panes.append(pane)
        wall(scenery, start, end, thickness_m, openings, panes)
        reliefs(scenery, start, end, [*openings, *panes], thickness_m, random)
    return found


def _free_stretch(
    random: np.random.Generator, length_m: float, width_m: float, taken: Sequence[tuple[float, float]]
) -> tuple[float, float] | None:
    """A random stretch of a wall that overlaps none of `taken`; None if none is found."""
    for _ in range(5):
        if length_m < width_m + 0.6:
            return None
        a = float(random.uniform(0.3, length_m - width_m - 0.3))
        if all(a + width_m + 0.15 < first or a > last + 0.15 for first, last in taken):
            return a, a + width_m
    return None


def threshold(
    scenery: Scenery, start: Corner, end: Corner, opening: tuple[float, float], random: np.random.Generator
) -> Corner:
    """Add the ground behind an opening of a side, often with a wall further away; returns a point on it, outside."""
    heading = math.atan2(end[1] - start[1], end[0] - start[0])
    first, last = opening
    middle = (first + last) / 2.0
    (ground, behind, point) = placed(
        [(middle, -0.5), (middle, -random.uniform(1.8, 4.0)), (middle, -1.0)], *start, heading
    )
    scenery.thresholds.append(Polygon(box(*ground, last - first + 0.3, 2.2, heading)))
    corridor = box(*behind, random.uniform(3.0, 8.0), 0.2, heading)
    if random.random() < 0.7 and not Polygon(corridor).intersects(scenery.inside):
        scenery.add(corridor)
    return point


def door_leaf(
    scenery: Scenery, start: Corner, end: Corner, opening: tuple[float, float], random: np.random.Generator
) -> None:
    """Add the leaf of an open door at one end of the opening, or none."""
    if random.random() < 0.5:
        return
    heading = math.atan2(end[1] - start[1], end[0] - start[0])
    first, last = opening
    width_m = min(last - first, 0.95)
    at_last = random.random() < 0.5
    (hinge,) = placed([(last if at_last else first, 0.0)], *start, heading)
    angle = heading + (math.pi if at_last else 0.0) + (-1 if at_last else 1) * random.uniform(1.3, 2.9)
    middle = (hinge[0] + width_m / 2 * math.cos(angle), hinge[1] + width_m / 2 * math.sin(angle))
    scenery.add(box(*middle, width_m, 0.045, angle))


def reliefs(
    scenery: Scenery,
    start: Corner,
    end: Corner,
    taken: Sequence[tuple[float, float]],
    thickness_m: float,
    random: np.random.Generator,
) -> None:
    """Add shallow projections to a wall: half-columns, frames of closed doors, pipes, skirtings."""
    length_m = math.dist(start, end)
    heading = math.atan2(end[1] - start[1], end[0] - start[0])
    for _ in range(random.poisson(length_m / 2.5)):
        stretch = _free_stretch(random, length_m, random.choice([0.1, 0.3, 0.9]), taken)
        if stretch is not None:
            depth_m = random.uniform(0.03, 0.3 if stretch[1] - stretch[0] < 0.5 else 0.12)
            (at,) = placed([(sum(stretch) / 2.0, thickness_m / 2.0 + depth_m / 2.0)], *start, heading)
            scenery.add(box(*at, stretch[1] - stretch[0], depth_m, heading))


def rectangle(x0: float, y0: float, x1: float, y1: float) -> Corners:
    """The corners of a rectangle, counter-clockwise from the lower left one."""
    return ((x0, y0), (x1, y0), (x1, y1), (x0, y1))
