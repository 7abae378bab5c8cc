"""Walls about rooms: with doors, open or shut, recesses and panes."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from shapely import Polygon

from gridtrack.simulation.tracks import Corner
from gridtrack.simulation.worlds.scenery import Corners, Scenery, box, counter_clockwise, placed, wall

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
