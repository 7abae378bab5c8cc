"""A place under construction: objects, walls, and the ground for walking."""

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
"""Between the middle of a walker and what blocks the way, besides the walker's radius."""
SIMPLER_M = 0.02
CEILING_M = 3.0


@dataclass(frozen=True)
class Thing:
    """What stands in a place: its outline, counter-clockwise, from which height to which, and how it reflects."""

    corners: Corners
    low_m: float = 0.0
    high_m: float = CEILING_M
    glass: bool = False
    dark: bool = False


@dataclass(frozen=True)
class Parked:
    """A road user that stands for good: its class, the pose of its centre, its length and width."""

    label: str
    pose: SE2
    size_m: tuple[float, float]


@dataclass(frozen=True)
class Lane:
    """The way (n, 2) of vehicles of a class, and how fast they go at most; nothing stands on one that is `clear`."""

    label: str
    way: NDArray[np.float64]
    speed: float
    clear: bool = True


@dataclass
class Scenery:
    """The things in an area, in metres.

    `inside` is the ground that a laser may stand on and that people go about in; `thresholds` extend it to where doors
    lead. Nobody walks on the grounds `blocked`; by `doors` people come and go; on `seats` (x, y, heading) somebody may
    sit; vehicles use `lanes`, and some are `parked`.
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
        """Add a thing with a simple outline; nobody walks where it stands if it `blocks`."""
        outline = counter_clockwise(corners)
        self.things.append(Thing(outline, low_m, high_m, glass, dark))
        if blocks:
            self.block(outline)

    def block(self, corners: Sequence[Corner]) -> None:
        """Let nobody walk inside `corners`."""
        self.blocked.append(Polygon(corners))

    def at(self, plane_m: float) -> list[Thing]:
        """The things that a plane at a height cuts."""
        return [thing for thing in self.things if thing.low_m <= plane_m < thing.high_m]

    def walkable(self, *standing: Corner, radius_m: float = 0.35) -> Polygon:
        """The largest connected ground where people walk, without a disc about each of `standing`."""
        discs = [shapely.Point(at).buffer(radius_m, quad_segs=4) for at in standing]
        solid = shapely.union_all([*self.blocked, *discs]).buffer(WALKER_CLEARANCE_M, quad_segs=2, join_style="mitre")
        area = shapely.union_all([self.inside, *self.thresholds])
        free = area.buffer(-WALKER_CLEARANCE_M).difference(solid).simplify(SIMPLER_M)
        # Opened, so that no part is connected by a crack that nobody passes.
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
    """A rectangle about (x, y), its length along `heading`."""
    return placed(
        [(a * length_m / 2.0, b * width_m / 2.0) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))], x, y, heading
    )


def disc(x: float, y: float, diameter_m: float, corners: int = 10) -> Corners:
    """A regular polygon in a circle about (x, y)."""
    angles = [2.0 * math.pi * k / corners for k in range(corners)]
    return tuple((x + diameter_m / 2.0 * math.cos(a), y + diameter_m / 2.0 * math.sin(a)) for a in angles)


def placed(corners: Sequence[Corner], x: float, y: float, heading: float) -> Corners:
    """Corners of a body's frame in the world, for the pose (x, y, heading)."""
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
    """A wall from `start` to `end`, with `openings` and panes of `glass`: from where to where along it, metres."""
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


DOOR_M = (0.85, 1.6)
PANE_M = (0.8, 3.0)


def enclose(
    scenery: Scenery, corners: Sequence[Corner], random: np.random.Generator, doors: int, glass: float
) -> list[Corner]:
    """Walls along all sides of a polygon, with `doors` open doors; gives a point behind each, outside.

    `glass` is the share of the stretches between doors that are panes down to the floor.
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
    """A stretch of a wall that overlaps none of `taken`; None where none is found."""
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
    """The ground behind an opening of a side, often with a wall further away; gives a point on it, outside."""
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
    """An open door's leaf at one end of the opening, or none."""
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
    """Shallow projections of a wall: half-columns, frames of shut doors, pipes, skirtings."""
    length_m = math.dist(start, end)
    heading = math.atan2(end[1] - start[1], end[0] - start[0])
    for _ in range(random.poisson(length_m / 2.5)):
        stretch = _free_stretch(random, length_m, random.choice([0.1, 0.3, 0.9]), taken)
        if stretch is not None:
            depth_m = random.uniform(0.03, 0.3 if stretch[1] - stretch[0] < 0.5 else 0.12)
            (at,) = placed([(sum(stretch) / 2.0, thickness_m / 2.0 + depth_m / 2.0)], *start, heading)
            scenery.add(box(*at, stretch[1] - stretch[0], depth_m, heading))


def rectangle(x0: float, y0: float, x1: float, y1: float) -> Corners:
    """Counter-clockwise from the lower left corner."""
    return ((x0, y0), (x1, y0), (x1, y1), (x0, y1))
