"""Places indoors: rooms, offices along a corridor, halls, corridors."""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np
import shapely
from shapely import Polygon

from gridtrack.simulation.tracks import Corner
from gridtrack.simulation.worlds.furniture import clutter, furnish, pillar, sofa
from gridtrack.simulation.worlds.scenery import (
    DOOR_M,
    Corners,
    Scenery,
    box,
    door_leaf,
    enclose,
    rectangle,
    reliefs,
    threshold,
    wall,
)


def room(random: np.random.Generator) -> Scenery:
    """A furnished room of a home, laboratory or café, and a neighbouring room through a door."""
    length_m, width_m, further_m = random.uniform(4.0, 11.0), random.uniform(3.5, 8.0), random.uniform(2.5, 5.0)
    first, second = rectangle(0, 0, length_m, width_m), rectangle(length_m, 0, length_m + further_m, width_m)
    scenery = Scenery(Polygon(rectangle(0.0, 0.0, length_m + further_m, width_m)))
    scenery.doors += enclose(scenery, first, random, int(random.integers(1, 4)), random.uniform(0.0, 0.3))
    scenery.doors += enclose(scenery, second, random, int(random.integers(1, 3)), 0.0)
    furnish(scenery, first, random, random.uniform(0.3, 1.0), scenery.doors)
    furnish(scenery, second, random, random.uniform(0.2, 0.8), scenery.doors)
    return scenery


class RowOfRooms(NamedTuple):
    """Rooms between a corridor wall at y = `near_m` and an outer wall at y = `far_m`, divided by walls at x =
    `ends`."""

    near_m: float
    far_m: float
    ends: list[float]

    @property
    def rooms(self) -> list[Corners]:
        """The inside of each room."""
        low, high = sorted((self.near_m, self.far_m))
        return [rectangle(a + 0.1, low + 0.15, b - 0.1, high - 0.15) for a, b in itertools.pairwise(self.ends)]


def office(random: np.random.Generator) -> Scenery:
    """Rooms on both sides of a corridor, most of their doors open."""
    length_m, corridor_m = random.uniform(12.0, 30.0), random.uniform(1.5, 3.0)
    depths = random.uniform(3.0, 6.5, 2)
    scenery = Scenery(Polygon(rectangle(0.0, -depths[0], length_m, corridor_m + depths[1])))
    _corridor_ends(scenery, length_m, corridor_m, random)
    keep = [*scenery.doors]
    for near_m, far_m in ((0.0, -depths[0]), (corridor_m, corridor_m + depths[1])):
        row = RowOfRooms(near_m, far_m, _cuts(random, length_m, 2.4, 6.5))
        openings = _partition_walls(scenery, row, random)
        keep += [((a + b) / 2.0, near_m) for a, b in openings]
        _corridor_wall(scenery, row, openings, random)
        _outer_walls(scenery, row, random)
        for corners in row.rooms:
            furnish(scenery, corners, random, random.uniform(0.3, 1.0), keep)
    for _ in range(random.poisson(length_m / 10.0)):
        spot = (random.uniform(1.0, length_m - 1.0), random.choice([0.35, corridor_m - 0.35]))
        if corridor_m > 1.9 and all(math.dist(spot, door) > 1.5 for door in keep):
            clutter(scenery, *spot, 0.0, random)
    return scenery


def hall(random: np.random.Generator) -> Scenery:
    """A hall with columns, counters and benches: a foyer, a canteen, a shop, a station."""
    length_m, width_m = random.uniform(10.0, 30.0), random.uniform(8.0, 20.0)
    corners: list[Corner] = list(rectangle(0, 0, length_m, width_m))
    if random.random() < 0.5:  # L-shaped
        x, y = length_m * random.uniform(0.5, 0.8), width_m * random.uniform(0.5, 0.8)
        corners = [(0, 0), (length_m, 0), (length_m, y), (x, y), (x, width_m), (0, width_m)]
    scenery = Scenery(Polygon(corners))
    scenery.doors += enclose(scenery, corners, random, int(random.integers(2, 6)), random.uniform(0.0, 0.5))
    ground = Polygon(corners).buffer(-0.8, join_style="mitre")
    if random.random() < 0.7:
        _columns(scenery, ground, random)
    if random.random() < 0.5:
        _rows_of_shelves(scenery, ground, random)
    furnish(
        scenery, rectangle(0.2, 0.2, length_m * 0.6, width_m * 0.6), random, random.uniform(0.0, 0.5), scenery.doors
    )
    for _ in range(random.poisson(length_m * width_m / 40.0)):
        at = shapely.Point(random.uniform(0, length_m), random.uniform(0, width_m))
        if ground.contains(at) and all(math.dist((at.x, at.y), door) > 1.5 for door in scenery.doors):
            (clutter, sofa)[random.integers(2)](scenery, at.x, at.y, random.integers(4) * math.pi / 2, random)
    return scenery


def corridor(random: np.random.Generator) -> Scenery:
    """Corridors: straight, an L, a T or a cross, with doors, niches and clutter along the walls."""
    width_m, across_m = random.uniform(1.6, 4.0), random.uniform(1.6, 3.5)
    length_m, at = random.uniform(12.0, 35.0), random.uniform(4.0, 9.0)
    below_m, above_m = (random.uniform(3.0, 10.0) * (random.random() < 0.5) for _ in range(2))
    main = shapely.box(0, 0, length_m, width_m)
    crossing = shapely.box(at, -below_m, at + across_m, width_m + above_m)
    niches = [
        shapely.box(x, -random.uniform(0.2, 1.2), x + random.uniform(0.8, 2.5), width_m + random.uniform(0.0, 0.6))
        for x in random.uniform(1.0, length_m - 3.0, random.integers(0, 4))
    ]
    outline = shapely.union_all([main, crossing, *niches]).simplify(0.01)
    corners = [(x, y) for x, y in outline.exterior.coords[:-1]]
    scenery = Scenery(outline)
    scenery.doors += enclose(scenery, corners, random, int(random.integers(2, 8)), random.uniform(0.0, 0.15))
    for _ in range(random.poisson(length_m / 5.0)):
        x, y = random.uniform(0.5, length_m - 0.5), random.choice([0.3, width_m - 0.3])
        spot = shapely.Point(x, y)
        if (
            width_m > 2.0
            and all(math.dist((x, y), door) > 1.6 for door in scenery.doors)
            and outline.contains(spot.buffer(0.25))
        ):
            clutter(scenery, x, y, 0.0, random)
    return scenery


def _corridor_ends(scenery: Scenery, length_m: float, corridor_m: float, random: np.random.Generator) -> None:
    """Close each end of a corridor along x with a wall, or continue it."""
    for start, end in (((0.0, corridor_m), (0.0, 0.0)), ((length_m, 0.0), (length_m, corridor_m))):
        if random.random() < 0.4:
            wall(scenery, start, end, 0.2)
        else:
            scenery.doors.append(threshold(scenery, start, end, (0.1, corridor_m - 0.1), random))


def _partition_walls(scenery: Scenery, row: RowOfRooms, random: np.random.Generator) -> list[tuple[float, float]]:
    """Add the walls between the rooms; returns the openings (first, last) along x of their doors to the corridor."""
    openings = []
    for a, b in itertools.pairwise(row.ends):
        middle, half = random.uniform(a + 0.9, b - 0.9), random.uniform(*DOOR_M) / 2.0
        if random.random() < 0.7 and middle - half > a + 0.2 and middle + half < b - 0.2:
            openings.append((middle - half, middle + half))
        wall(scenery, (b, row.near_m), (b, row.far_m), random.choice([0.1, 0.15, 0.25]))
    return openings


def _corridor_wall(
    scenery: Scenery, row: RowOfRooms, openings: list[tuple[float, float]], random: np.random.Generator
) -> None:
    """Add the wall between the rooms and the corridor, with panes and door leaves."""
    length_m = row.ends[-1]
    start, end = (0.0, row.near_m), (length_m, row.near_m)
    panes = [(a + 0.2, a + 1.0) for a, b in openings if random.random() < 0.1]
    wall(scenery, start, end, 0.16, openings, [pane for pane in panes if _apart(pane, openings)])
    for opening in openings:
        door_leaf(scenery, start, end, opening, random)
    if row.far_m > row.near_m:
        reliefs(scenery, start, end, openings, 0.16, random)
    else:
        reliefs(scenery, end, start, [(length_m - b, length_m - a) for a, b in openings], 0.16, random)


def _outer_walls(scenery: Scenery, row: RowOfRooms, random: np.random.Generator) -> None:
    """Add the outer wall with windows, and the wall at x = 0."""
    windows = [(a + 0.5, b - 0.5) for a, b in itertools.pairwise(row.ends) if random.random() < 0.1]
    wall(scenery, (0.0, row.far_m), (row.ends[-1], row.far_m), 0.3, (), windows)
    wall(scenery, (0.0, row.near_m), (0.0, row.far_m), 0.3)


def _cuts(random: np.random.Generator, length_m: float, least_m: float, most_m: float) -> list[float]:
    """Positions from 0 to `length_m` that are `least_m` to `most_m` apart."""
    ends = [0.0]
    while length_m - ends[-1] > most_m:
        ends.append(ends[-1] + float(random.uniform(least_m, min(most_m, length_m - ends[-1] - least_m))))
    return [*ends, length_m]


def _apart(stretch: tuple[float, float], taken: list[tuple[float, float]]) -> bool:
    return all(stretch[1] < a - 0.1 or stretch[0] > b + 0.1 for a, b in taken)


def _columns(scenery: Scenery, ground: Polygon, random: np.random.Generator) -> None:
    """Add equal columns on a grid."""
    x0, y0, x1, y1 = ground.bounds
    every = random.uniform(3.0, 7.0, 2)
    build = int(random.integers(1 << 30))
    for x in np.arange(x0 + random.uniform(1.0, 3.0), x1, every[0]):
        for y in np.arange(y0 + random.uniform(1.0, 2.0), y1, every[1]):
            if ground.contains(shapely.Point(x, y)) and all(math.dist((x, y), door) > 1.4 for door in scenery.doors):
                pillar(scenery, float(x), float(y), 0.0, np.random.default_rng(build))


def _rows_of_shelves(scenery: Scenery, ground: Polygon, random: np.random.Generator) -> None:
    x0, y0, x1, y1 = ground.bounds
    length_m, depth_m, every_m = random.uniform(1.5, 5.0), random.uniform(0.4, 1.0), random.uniform(1.8, 3.2)
    for y in np.arange(y0 + 1.5, y0 + (y1 - y0) * random.uniform(0.3, 0.9), every_m + depth_m):
        shelf = Polygon(box(x0 + (x1 - x0) * 0.65, float(y), length_m, depth_m))
        if ground.contains(shelf) and all(shelf.distance(other) > 0.9 for other in scenery.blocked):
            scenery.add(list(shelf.exterior.coords)[:-1], high_m=random.uniform(1.0, 2.2))
