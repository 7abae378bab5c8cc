"""The layout of the junction: its static objects, the pose of the laser, and the window that is scored.

Two streets cross at the origin of the world frame, x east, y north. Each has a lane of 4.2 m and a pavement of 2.8 m
on either side, so houses are at least 7 m from the middle of the street; the corners are cut, where pedestrians wait.
The laser is on the north-western corner, between the pavement and the house behind it.
"""

from __future__ import annotations

import math

from gridtrack.simulation.bodies import ellipse
from gridtrack.simulation.laser import Laser

JUNCTION_CLASSES = ("pedestrian", "cyclist", "car", "bus", "static")
JUNCTION_SITE = "junction"
JUNCTION_NODE = "C"
"""The name of the junction in the network."""
RATE_HZ = 8.0
CYCLE_S = 96.0
"""Period of the signals: a phase for each street, and one for all pedestrians."""
JUNCTION_GRID = "100x0.2@-4,-16"
"""The window, 20 m square, in the frame of the laser, which has the axes of the world and is at (-8, 8)."""
LASER = Laser(x=-8.0, y=8.0, angle_min=-math.pi)
"""Its blind quarter is towards the house behind it, in the north-west."""

CornerList = tuple[tuple[float, float], ...]

BLOCK_M = 45.0
"""Extent of the houses, beyond the maximum range of the laser."""
SOUTH_EAST, NORTH_WEST, SOUTH_WEST = -1, 1, 2
"""Quarters of the junction, in turns from the north-eastern one."""


def static_outlines() -> tuple[CornerList, ...]:
    """Four houses with cut corners; the north-eastern one is further from the street, behind trees and a kiosk."""
    houses = (
        _house(9.5, 11.0),
        _rotated(_house(7.3, 9.7), NORTH_WEST),
        _rotated(_house(7.3, 8.8), SOUTH_WEST),
        _rotated(_house(7.3, 8.8), SOUTH_EAST),
    )
    kiosk = ((7.3, 9.0), (8.9, 9.0), (8.9, 10.8), (7.3, 10.8))
    trees = [_round(7.55, y, 0.2) for y in (11.7, 14.5, 17.5, 20.5)] + [_round(x, 7.6, 0.2) for x in (11.5, 15.0, 18.5)]
    posts = [_rotated(_round(7.87, 7.87, 0.08), turn) for turn in (0, SOUTH_WEST, SOUTH_EAST)]
    return (*houses, kiosk, *trees, *posts)


def _house(facade_m: float, corner_m: float) -> CornerList:
    """The north-eastern house: fronts at `facade_m` from the middle of the streets, corner cut at `corner_m`."""
    fronts = ((corner_m, facade_m), (BLOCK_M, facade_m), (BLOCK_M, BLOCK_M))
    return (*fronts, (facade_m, BLOCK_M), (facade_m, corner_m))


def _rotated(outline: CornerList, turns: int) -> CornerList:
    """`outline` rotated about the middle of the junction by quarter turns, counter-clockwise."""
    for _ in range(turns % 4):
        outline = tuple((0.0 - y, x) for x, y in outline)
    return outline


def _round(x: float, y: float, radius: float) -> CornerList:
    return tuple((round(x + dx, 4), round(y + dy, 4)) for dx, dy in ellipse(2.0 * radius, 2.0 * radius, 8))
