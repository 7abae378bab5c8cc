"""Objects in a place: furniture, plants, street furniture, parked vehicles and house fronts."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import shapely

from gridtrack.common.geometry import SE2
from gridtrack.simulation.tracks import Corner
from gridtrack.simulation.worlds.scenery import Corners, Parked, Scenery, box, disc, placed

Piece = Callable[[Scenery, float, float, float, np.random.Generator], object]
"""Adds a piece of furniture at x, y with a heading."""
TABLE_TOP_M, SEAT_M, BACK_M = 0.72, 0.44, 0.9
LEAF_M = (0.03, 0.12)
CAR_SIZES_M = ((3.9, 1.7), (4.5, 1.82), (4.8, 1.9), (5.4, 2.0))
BICYCLE_SIZE_M = (1.75, 0.6)


def table(scenery: Scenery, x: float, y: float, heading: float, random: np.random.Generator) -> tuple[float, float]:
    """A table, often with a closed side; returns its length and width."""
    length_m, width_m = random.uniform(1.0, 2.0), random.uniform(0.6, 1.0)
    leg_m = random.uniform(0.03, 0.08)
    if random.random() < 0.2:  # a round one, on one foot
        length_m = width_m = random.uniform(0.6, 1.1)
        scenery.add(disc(x, y, random.uniform(0.08, 0.5)), high_m=TABLE_TOP_M, blocks=False)
    else:
        for a in (-1, 1):
            for b in (-1, 1):
                (at,) = placed([(a * (length_m / 2 - 0.06), b * (width_m / 2 - 0.06))], x, y, heading)
                scenery.add(box(*at, leg_m, leg_m, heading), high_m=TABLE_TOP_M, blocks=False)
        if random.random() < 0.3:
            (at,) = placed([(length_m / 2 - 0.25, 0.0)], x, y, heading)
            scenery.add(box(*at, 0.42, width_m - 0.15, heading), high_m=0.6, blocks=False)
    scenery.block(box(x, y, length_m, width_m, heading))
    return length_m, width_m


def chair(scenery: Scenery, x: float, y: float, heading: float, random: np.random.Generator) -> None:
    """A chair facing `heading`: four legs or the star of an office chair, and a back above the seat."""
    leg_m = random.uniform(0.02, 0.035)
    if random.random() < 0.3:
        turned = random.uniform(0.0, math.tau)
        scenery.add(disc(x, y, 0.07, 6), low_m=0.08, high_m=SEAT_M, blocks=False)
        for k in range(5):
            angle = turned + math.tau * k / 5
            at = (x + 0.15 * math.cos(angle), y + 0.15 * math.sin(angle))
            scenery.add(box(*at, 0.28, 0.04, angle), high_m=0.08, blocks=False)
    else:
        for a in (-0.19, 0.19):
            for b in (-0.19, 0.19):
                (at,) = placed([(a, b)], x, y, heading)
                scenery.add(box(*at, leg_m, leg_m, heading), high_m=SEAT_M, blocks=False)
    (at,) = placed([(-0.2, 0.0)], x, y, heading)
    scenery.add(box(*at, 0.04, 0.42, heading), low_m=SEAT_M, high_m=BACK_M, blocks=False)
    scenery.block(box(x, y, 0.42, 0.42, heading))


def table_with_chairs(scenery: Scenery, x: float, y: float, heading: float, random: np.random.Generator) -> None:
    """A table with up to six chairs at various distances, some of them seats for people."""
    length_m, width_m = table(scenery, x, y, heading, random)
    places = [(a * length_m, side) for side in (-1, 1) for a in ((-0.25, 0.25) if length_m > 1.3 else (0.0,))]
    for a, side in places:
        if random.random() < 0.25:
            continue
        away_m = width_m / 2 + random.uniform(-0.05, 0.35)
        (at,) = placed([(a + random.normal(0.0, 0.06), side * away_m)], x, y, heading)
        facing = heading - side * math.pi / 2 + random.normal(0.0, 0.25)
        chair(scenery, *at, facing, random)
        if random.random() < 0.3:
            scenery.seats.append((*at, facing))


def cabinet(scenery: Scenery, x: float, y: float, heading: float, random: np.random.Generator) -> None:
    """A cupboard, shelf or counter; its length along `heading`."""
    corners = box(x, y, random.uniform(0.6, 1.8), random.uniform(0.3, 0.6), heading)
    scenery.add(corners, high_m=random.uniform(0.7, 2.0), dark=random.random() < 0.15)


def clutter(scenery: Scenery, x: float, y: float, heading: float, random: np.random.Generator) -> None:
    """A small object: a box, bin, plant, irregular heap, radiator or tripod stand."""
    kind = random.integers(6)
    if kind == 0:
        scenery.add(
            box(x, y, random.uniform(0.25, 0.6), random.uniform(0.25, 0.6), heading + random.normal(0.0, 0.3)),
            high_m=0.7,
        )
    elif kind == 1:
        scenery.add(disc(x, y, random.uniform(0.22, 0.4)), high_m=0.8, dark=random.random() < 0.3)
    elif kind == 2:
        scenery.add(disc(x, y, random.uniform(0.3, 0.6)), high_m=0.5)
        scenery.add(disc(x, y, random.uniform(0.05, 0.1), 6), low_m=0.5, high_m=1.6, blocks=False)
    elif kind == 3:
        angles = np.sort(random.uniform(0.0, math.tau, 7))
        radii = random.uniform(0.12, 0.4, 7)
        heap = shapely.MultiPoint(
            [(x + r * math.cos(a), y + r * math.sin(a)) for r, a in zip(radii, angles, strict=True)]
        )
        scenery.add(list(heap.convex_hull.exterior.coords)[:-1], high_m=random.uniform(0.4, 1.0))
    elif kind == 4:
        scenery.add(box(x, y, random.uniform(0.6, 1.6), 0.1, heading), low_m=0.1, high_m=0.7)
    else:
        for k in range(3):
            angle = heading + math.tau * k / 3
            foot = (x + 0.25 * math.cos(angle), y + 0.25 * math.sin(angle))
            scenery.add(box(*foot, 0.05, 0.03, angle), blocks=False)
        scenery.block(disc(x, y, 0.6, 8))


def sofa(scenery: Scenery, x: float, y: float, heading: float, random: np.random.Generator) -> None:
    """A sofa or bench with seats, facing across its length."""
    length_m = random.uniform(1.2, 2.4)
    if random.random() < 0.5:
        scenery.add(box(x, y, length_m, 0.8, heading), low_m=0.06, high_m=0.75, dark=random.random() < 0.3)
        front_m = 0.45
    else:
        for a in (-0.42, 0.42):
            (at,) = placed([(a * length_m, 0.0)], x, y, heading)
            scenery.add(box(*at, 0.06, 0.38, heading), high_m=0.42, blocks=False)
        scenery.block(box(x, y, length_m, 0.42, heading))
        front_m = 0.25
    if random.random() < 0.4:
        (at,) = placed([(random.uniform(-0.3, 0.3) * length_m, front_m - 0.2)], x, y, heading)
        scenery.seats.append((*at, heading + math.pi / 2))


def pillar(scenery: Scenery, x: float, y: float, heading: float, random: np.random.Generator) -> None:
    """A round or square column."""
    across_m = random.uniform(0.25, 0.8)
    scenery.add(disc(x, y, across_m, 14) if random.random() < 0.5 else box(x, y, across_m, across_m, heading))


def furnish(scenery: Scenery, corners: Corners, random: np.random.Generator, amount: float, keep: list[Corner]) -> None:
    """Furnish a rectangular room, given by four corners, along its walls and in the middle.

    `amount` from 0 to 1 scales the number of pieces; the ground around each point of `keep` (doors) stays free.
    """
    x0, y0 = corners[0]
    length_m, width_m = math.dist(corners[0], corners[1]), math.dist(corners[1], corners[2])
    heading = math.atan2(corners[1][1] - y0, corners[1][0] - x0)
    for _ in range(round(amount * (length_m + width_m) * 0.9)):
        side, along, depth = random.integers(4), random.uniform(0.1, 0.9), random.uniform(0.3, 0.5)
        spots = ((along * length_m, depth), (length_m - depth, along * width_m), (along * length_m, width_m - depth))
        spot = (*spots, (depth, along * width_m))[side]
        (at,) = placed([spot], x0, y0, heading)
        choice = (cabinet, clutter, clutter, sofa)[random.integers(4)]
        _if_free(scenery, choice, at, heading + side * math.pi / 2, random, keep, 1.1)
    for _ in range(round(amount * length_m * width_m / 5.0)):
        (at,) = placed(
            [(random.uniform(1.0, max(length_m - 1.0, 1.1)), random.uniform(1.0, max(width_m - 1.0, 1.1)))],
            x0,
            y0,
            heading,
        )
        choice = (table_with_chairs, table_with_chairs, chair, clutter)[random.integers(4)]
        turned = heading + random.integers(4) * math.pi / 2 + random.normal(0.0, 0.05)
        _if_free(scenery, choice, at, turned, random, keep, 1.3)


def _if_free(
    scenery: Scenery,
    add: Piece,
    at: Corner,
    heading: float,
    random: np.random.Generator,
    keep: list[Corner],
    reach_m: float,
) -> None:
    """Place a piece unless it would overlap another one, or block a door."""
    if any(math.dist(at, door) < reach_m + 0.5 for door in keep):
        return
    trial = Scenery(scenery.inside)
    add(trial, *at, heading, random)
    ground = shapely.union_all(trial.blocked)
    if not scenery.inside.contains(ground) or any(ground.distance(other) < 0.02 for other in scenery.blocked):
        return
    scenery.things += trial.things
    scenery.blocked += trial.blocked
    scenery.seats += trial.seats


def tree(scenery: Scenery, x: float, y: float, random: np.random.Generator) -> None:
    """A trunk, sometimes with shoots around it."""
    scenery.add(disc(x, y, random.uniform(0.15, 0.6), 9))
    if random.random() < 0.2:
        leaves(scenery, x, y, random.uniform(0.3, 0.6), random)


def leaves(scenery: Scenery, x: float, y: float, radius_m: float, random: np.random.Generator) -> None:
    """A bush: leaves and twigs with gaps that beams can pass."""
    for _ in range(round(28 * min(radius_m, 1.2))):
        angle, away_m = random.uniform(0.0, math.tau), radius_m * math.sqrt(random.uniform(0.1, 1.0))
        at = (x + away_m * math.cos(angle), y + away_m * math.sin(angle))
        scenery.add(box(*at, random.uniform(*LEAF_M), 0.02, random.uniform(0.0, math.pi)), blocks=False)
    scenery.block(disc(x, y, 2.0 * radius_m, 8))


def hedge(scenery: Scenery, start: Corner, end: Corner, random: np.random.Generator) -> None:
    """A row of bushes."""
    length_m = math.dist(start, end)
    for along in np.arange(0.4, length_m, 0.7):
        share = along / length_m
        at = (start[0] + share * (end[0] - start[0]), start[1] + share * (end[1] - start[1]))
        leaves(scenery, *at, random.uniform(0.35, 0.5), random)


def bench(scenery: Scenery, x: float, y: float, heading: float, random: np.random.Generator) -> None:
    """A bench with a seat facing across its length; its feet are at shin height."""
    for a in (-0.7, 0.7):
        (at,) = placed([(a, 0.0)], x, y, heading)
        scenery.add(box(*at, 0.08, 0.42, heading), high_m=0.45, blocks=False)
    (at,) = placed([(0.0, -0.22)], x, y, heading)
    scenery.add(box(*at, 1.6, 0.05, heading), low_m=0.5, high_m=0.95, blocks=False)
    scenery.block(box(x, y, 1.7, 0.5, heading))
    if random.random() < 0.6:
        (at,) = placed([(random.uniform(-0.5, 0.5), 0.1)], x, y, heading)
        scenery.seats.append((*at, heading + math.pi / 2))


def small_thing(scenery: Scenery, x: float, y: float, heading: float, random: np.random.Generator) -> None:
    """A post, bin, planter, letter box, advertising column, or a row of bollards."""
    kind = random.integers(6)
    if kind == 0:
        scenery.add(disc(x, y, random.uniform(0.08, 0.25), 8))
    elif kind == 1:
        scenery.add(disc(x, y, random.uniform(0.3, 0.5), 10), high_m=1.0)
    elif kind == 2:
        scenery.add(
            box(x, y, random.uniform(0.6, 2.0), random.uniform(0.5, 1.2), heading), high_m=random.uniform(0.35, 0.8)
        )
    elif kind == 3:
        scenery.add(box(x, y, 0.6, 0.5, heading), high_m=1.4)
    elif kind == 4:
        scenery.add(disc(x, y, random.uniform(1.0, 1.5), 14))
    else:
        for k in range(int(random.integers(3, 7))):
            (at,) = placed([(1.4 * k, 0.0)], x, y, heading)
            scenery.add(disc(*at, 0.16, 8), high_m=0.9)


def parked_bicycles(scenery: Scenery, x: float, y: float, heading: float, random: np.random.Generator) -> None:
    """Bicycles side by side at a rack: thin static frames."""
    for k in range(int(random.integers(2, 8))):
        (at,) = placed([(0.6 * k, 0.0)], x, y, heading)
        turned = heading + math.pi / 2 + random.normal(0.0, 0.08)
        scenery.add(box(*at, random.uniform(1.5, 1.8), 0.06, turned), high_m=0.9)


def parked_car(scenery: Scenery, x: float, y: float, heading: float, random: np.random.Generator) -> None:
    """A parked car; nobody walks through it."""
    size_m = CAR_SIZES_M[random.integers(len(CAR_SIZES_M))]
    scenery.parked.append(Parked("car", SE2(x, y, heading), size_m))
    scenery.block(box(x, y, *size_m, heading))


def house_front(scenery: Scenery, start: Corner, end: Corner, random: np.random.Generator) -> None:
    """Houses to the right of a line, with set-backs, doorways, steps and shop windows."""
    length_m = math.dist(start, end)
    heading = math.atan2(end[1] - start[1], end[0] - start[0])
    at = 0.0
    while at < length_m - 0.5:
        width_m = min(float(random.uniform(4.0, 12.0)), length_m - at)
        back_m = float(random.choice([0.0, 0.0, random.uniform(0.1, 1.5)]))
        corners = [(at, -back_m), *_doorways(at, width_m, back_m, random), (at + width_m, -back_m)]
        corners += [(at + width_m, -3.0 - back_m), (at, -3.0 - back_m)]
        scenery.add(placed(corners, *start, heading))
        if random.random() < 0.2 and width_m > 4.0:
            (pane,) = placed([(at + width_m / 2, -back_m + 0.04)], *start, heading)
            scenery.add(box(*pane, width_m * 0.5, 0.04, heading), glass=True)
        at += width_m


def _doorways(at: float, width_m: float, back_m: float, random: np.random.Generator) -> list[Corner]:
    """Corners of recesses in a front, along x."""
    found: list[Corner] = []
    along = at + float(random.uniform(0.5, 2.0))
    while along < at + width_m - 2.0:
        wide_m, deep_m = float(random.uniform(0.9, 1.6)), float(random.uniform(-0.15, 0.6))
        found += [
            (along, -back_m),
            (along, -back_m - deep_m),
            (along + wide_m, -back_m - deep_m),
            (along + wide_m, -back_m),
        ]
        along += wide_m + float(random.uniform(1.0, 5.0))
    return found
