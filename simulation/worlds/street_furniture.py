"""What stands outdoors: trees, bushes, benches, posts, kiosks, parked cars and bicycles, house fronts."""

from __future__ import annotations

import math

import numpy as np

from gridtrack.common.geometry import SE2
from gridtrack.simulation.tracks import Corner
from gridtrack.simulation.worlds.scenery import Parked, Scenery, box, disc, placed

LEAF_M = (0.03, 0.12)
CAR_SIZES_M = ((3.9, 1.7), (4.5, 1.82), (4.8, 1.9), (5.4, 2.0))
BICYCLE_SIZE_M = (1.75, 0.6)


def tree(scenery: Scenery, x: float, y: float, random: np.random.Generator) -> None:
    """A trunk, at times with shoots about it."""
    scenery.add(disc(x, y, random.uniform(0.15, 0.6), 9))
    if random.random() < 0.2:
        leaves(scenery, x, y, random.uniform(0.3, 0.6), random)


def leaves(scenery: Scenery, x: float, y: float, radius_m: float, random: np.random.Generator) -> None:
    """A bush: leaves and twigs, between which a beam goes deeper or through."""
    for _ in range(round(28 * min(radius_m, 1.2))):
        angle, away_m = random.uniform(0.0, math.tau), radius_m * math.sqrt(random.uniform(0.1, 1.0))
        at = (x + away_m * math.cos(angle), y + away_m * math.sin(angle))
        scenery.add(box(*at, random.uniform(*LEAF_M), 0.02, random.uniform(0.0, math.pi)), blocks=False)
    scenery.block(disc(x, y, 2.0 * radius_m, 8))


def hedge(scenery: Scenery, start: Corner, end: Corner, random: np.random.Generator) -> None:
    """Bushes in a row."""
    length_m = math.dist(start, end)
    for along in np.arange(0.4, length_m, 0.7):
        share = along / length_m
        at = (start[0] + share * (end[0] - start[0]), start[1] + share * (end[1] - start[1]))
        leaves(scenery, *at, random.uniform(0.35, 0.5), random)


def bench(scenery: Scenery, x: float, y: float, heading: float, random: np.random.Generator) -> None:
    """A bench with seats that look across it; its feet at shin height."""
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
    """A post, bin, planter, letter box, advertising column or row of bollards."""
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
    """Bicycles side by side at a rack: thin frames that do not move."""
    for k in range(int(random.integers(2, 8))):
        (at,) = placed([(0.6 * k, 0.0)], x, y, heading)
        turned = heading + math.pi / 2 + random.normal(0.0, 0.08)
        scenery.add(box(*at, random.uniform(1.5, 1.8), 0.06, turned), high_m=0.9)


def parked_car(scenery: Scenery, x: float, y: float, heading: float, random: np.random.Generator) -> None:
    """A car that stands for good; nobody walks through it."""
    size_m = CAR_SIZES_M[random.integers(len(CAR_SIZES_M))]
    scenery.parked.append(Parked("car", SE2(x, y, heading), size_m))
    scenery.block(box(x, y, *size_m, heading))


def house_front(
    scenery: Scenery, start: Corner, end: Corner, random: np.random.Generator, depth_m: float = 3.0
) -> None:
    """Houses along a line, to its right, with set-backs, doorways, steps and shop windows."""
    length_m = math.dist(start, end)
    heading = math.atan2(end[1] - start[1], end[0] - start[0])
    at = 0.0
    while at < length_m - 0.5:
        width_m = min(float(random.uniform(4.0, 12.0)), length_m - at)
        back_m = float(random.choice([0.0, 0.0, random.uniform(0.1, 1.5)]))
        corners = [(at, -back_m), *_doorways(at, width_m, back_m, random), (at + width_m, -back_m)]
        corners += [(at + width_m, -depth_m - back_m), (at, -depth_m - back_m)]
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
