"""Places outdoors without a street network: plazas and car parks."""

from __future__ import annotations

import math

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import Polygon

from gridtrack.simulation.tracks import Corner
from gridtrack.simulation.worlds.furniture import (
    bench,
    hedge,
    house_front,
    leaves,
    parked_bicycles,
    parked_car,
    small_thing,
    tree,
)
from gridtrack.simulation.worlds.scenery import Lane, Scenery, disc, rectangle

AISLE_M, BAY_M, BAY_WIDTH_M = 6.0, 5.2, 2.6


def plaza(random: np.random.Generator) -> Scenery:
    """A square between houses, with streets at its corners, trees, benches, and cyclists who cross it."""
    sides = int(random.integers(3, 7))
    radius_m = random.uniform(9.0, 22.0)
    angles = np.sort(math.tau * (np.arange(sides) + random.uniform(-0.25, 0.25, sides)) / sides)
    corners: list[Corner] = [(radius_m * math.cos(a), radius_m * math.sin(a)) for a in angles]
    scenery = Scenery(Polygon(corners).buffer(3.0, join_style="mitre"))
    for start, end in zip(corners, [*corners[1:], corners[0]], strict=True):
        _plaza_side(scenery, start, end, random)
    scenery.doors += [(x * 1.12, y * 1.12) for x, y in corners]
    ground = Polygon(corners).buffer(-2.0)
    if random.random() < 0.6:
        every_m = random.uniform(4.0, 9.0)
        for x, y in _grid_points(ground, every_m, random.uniform(0.0, math.pi)):
            if random.random() < 0.7:
                tree(scenery, x, y, random)
    for _ in range(random.poisson(ground.area / 40.0)):
        x, y = random_point(ground, random)
        heading = random.uniform(0.0, math.tau)
        kind = random.integers(4)
        if kind == 0:
            bench(scenery, x, y, heading, random)
        elif kind == 1:
            leaves(scenery, x, y, random.uniform(0.4, 1.2), random)
        elif kind == 2 and random.random() < 0.3:
            parked_bicycles(scenery, x, y, heading, random)
        else:
            small_thing(scenery, x, y, heading, random)
    if random.random() < 0.3:
        scenery.add(disc(0.0, 0.0, random.uniform(2.0, 6.0), 20), high_m=0.7)
    for _ in range(random.poisson(3.0)):
        scenery.lanes.append(_across(scenery, corners, random))
    return scenery


def _plaza_side(scenery: Scenery, start: Corner, end: Corner, random: np.random.Generator) -> None:
    """Add houses along a side with a gap at both ends, or a hedge, or nothing."""
    length_m = math.dist(start, end)
    gap = min(random.uniform(2.0, 4.0) / length_m, 0.3)
    a = (start[0] + gap * (end[0] - start[0]), start[1] + gap * (end[1] - start[1]))
    b = (end[0] - gap * (end[0] - start[0]), end[1] - gap * (end[1] - start[1]))
    kind = random.random()
    if kind < 0.75:
        # the line runs counter-clockwise: its right is outside
        house_front(scenery, a, b, random)
    elif kind < 0.9:
        hedge(scenery, a, b, random)


def _across(scenery: Scenery, corners: list[Corner], random: np.random.Generator) -> Lane:
    """The lane of a cyclist from one corner to another, around the things in between."""
    first, last = random.choice(len(corners), 2, replace=False)
    solid = shapely.union_all(scenery.blocked).buffer(0.7)
    ends = [np.array(corners[k]) * 1.3 for k in (first, last)]
    for _ in range(40):
        middle = np.array(random_point(scenery.inside.buffer(-4.0), random))
        lane = np.array([ends[0], ends[0] / 1.3, middle, ends[1] / 1.3, ends[1]])
        if not shapely.LineString(lane).intersects(solid):
            break
    return Lane("cyclist", lane, random.uniform(2.0, 5.0), clear=not shapely.LineString(lane).intersects(solid))


def car_park(random: np.random.Generator) -> Scenery:
    """Rows of parking bays along aisles, some of them free; cars drive along the aisles, people walk between them."""
    rows, bays = int(random.integers(1, 4)), int(random.integers(6, 14))
    length_m, width_m = bays * BAY_WIDTH_M, rows * (AISLE_M + 2.0 * BAY_M)
    margin_m = 6.0
    scenery = Scenery(Polygon(rectangle(-margin_m, -3.0, length_m + margin_m, width_m + 3.0)))
    taken = random.uniform(0.3, 0.95)
    slant = random.choice([0.0, 0.0, 0.35])
    for row in range(rows):
        y0 = row * (AISLE_M + 2.0 * BAY_M)
        for side in (0, 1):
            y = y0 + (BAY_M / 2.0 if side == 0 else BAY_M * 1.5 + AISLE_M)
            for bay in range(bays):
                if random.random() < taken:
                    heading = (math.pi / 2 if random.random() < 0.6 else -math.pi / 2) + slant
                    offset = random.normal(0.0, 0.15, 2)
                    parked_car(
                        scenery,
                        (bay + 0.5) * BAY_WIDTH_M + offset[0],
                        y + offset[1],
                        heading + random.normal(0.0, 0.03),
                        random,
                    )
        _aisle(scenery, y0 + BAY_M + AISLE_M / 2.0, length_m, margin_m, random)
        for x in np.arange(random.uniform(0, 3) * BAY_WIDTH_M, length_m, BAY_WIDTH_M * int(random.integers(2, 6))):
            small_thing_between = (tree, _lamp)[random.integers(2)]
            if row:
                small_thing_between(scenery, float(x), y0, random)
    _car_park_edges(scenery, length_m, width_m, margin_m, random)
    return scenery


def _lamp(scenery: Scenery, x: float, y: float, random: np.random.Generator) -> None:
    scenery.add(disc(x, y, random.uniform(0.1, 0.35), 8))


def _aisle(scenery: Scenery, y: float, length_m: float, margin_m: float, random: np.random.Generator) -> None:
    """Add the lanes of an aisle in both directions, and a door at each end."""
    ends = (-margin_m - 25.0, length_m + margin_m + 25.0)
    scenery.doors += [(-margin_m + 1.0, y + 2.0), (length_m + margin_m - 1.0, y - 2.0)]
    for sign in (1, -1):
        if random.random() < 0.7:
            line: NDArray[np.float64] = np.array([(ends[0], y - 1.4 * sign), (ends[1], y - 1.4 * sign)])[::sign]
            label = "cyclist" if random.random() < 0.15 else "car"
            scenery.lanes.append(Lane(label, line, random.uniform(2.0, 5.0)))


def _car_park_edges(
    scenery: Scenery, length_m: float, width_m: float, margin_m: float, random: np.random.Generator
) -> None:
    """Add a house front, a hedge or a fence of posts along each long side."""
    for start, end in (
        ((-margin_m, -2.0), (length_m + margin_m, -2.0)),
        ((length_m + margin_m, width_m + 2.0), (-margin_m, width_m + 2.0)),
    ):
        kind = random.integers(4)
        if kind == 0:
            house_front(scenery, start, end, random)
        elif kind == 1:
            hedge(scenery, start, end, random)
        elif kind == 2:
            for share in np.arange(0.0, 1.0, 2.5 / math.dist(start, end)):
                x = start[0] + share * (end[0] - start[0])
                scenery.add(disc(float(x), start[1], 0.07, 6))


def random_point(ground: Polygon, random: np.random.Generator) -> Corner:
    """A random point of a polygon."""
    x0, y0, x1, y1 = ground.bounds
    while True:
        x, y = float(random.uniform(x0, x1)), float(random.uniform(y0, y1))
        if ground.contains(shapely.Point(x, y)):
            return (x, y)


def _grid_points(ground: Polygon, every_m: float, turned: float) -> list[Corner]:
    """The points of a rotated square grid inside a polygon."""
    reach = np.arange(-40.0, 40.0, every_m)
    c, s = math.cos(turned), math.sin(turned)
    points = [(float(c * x - s * y), float(s * x + c * y)) for x in reach for y in reach]
    return [at for at in points if ground.contains(shapely.Point(at))]
