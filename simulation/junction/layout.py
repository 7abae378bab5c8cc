"""The layout of the junction: its static objects, the pose of the laser, and the scored window.

Two streets cross at the origin of the world frame, x east, y north. Each has a lane of 4.2 m and a pavement of 2.8 m
on both sides, so houses are at least 7 m from the middle of the street. The corners of the houses are cut off, where
pedestrians wait. The laser is on the north-western corner, between the pavement and the house.
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
"""The window, 20 m square, in the frame of the laser at (-8, 8), which is parallel to the world frame."""
LASER = Laser(x=-8.0, y=8.0, angle_min=-math.pi)
"""Its blind quarter faces the house behind it, in the north-west."""
CORNER_LASERS = {"north-west": LASER, "south-east": Laser(x=8.0, y=-8.0, angle_min=0.0)}
"""The same laser, and one on the opposite corner in place of the signal post, out of the way of pedestrians; its blind
quarter faces the house there."""
CornerList = tuple[tuple[float, float], ...]
BLOCK_M = 45.0
"""Extent of the houses, beyond the maximum range of the laser."""
FACADE_M = 7.3
LANE_EDGE_M = 4.2
"""Distance of the kerbs from the middle of the street."""
FURTHER_HOUSES = ((47.0, 57.5, 0.0), (60.0, 70.0, 0.8), (71.5, 84.0, 0.3), (87.0, 98.0, 1.2), (100.0, 115.0, 0.0))
"""Start and end along a street, and set-back from the front of the first houses; the streets end at 100 m."""
FURTHER_HOUSE_DEPTH_M = 10.0
SOUTH_EAST, NORTH_WEST, SOUTH_WEST = -1, 1, 2
"""Quarters of the junction, in quarter turns from the north-eastern one."""


def static_outlines(*, south_eastern_post: bool = True) -> tuple[CornerList, ...]:
    """Four houses with cut corners, a kiosk, trees and signal posts; the north-eastern house is behind the trees."""
    houses = (
        _house(9.5, 11.0),
        _rotated(_house(FACADE_M, 9.7), NORTH_WEST),
        _rotated(_house(FACADE_M, 8.8), SOUTH_WEST),
        _rotated(_house(FACADE_M, 8.8), SOUTH_EAST),
    )
    kiosk = ((7.3, 9.0), (8.9, 9.0), (8.9, 10.8), (7.3, 10.8))
    trees = [_round(7.55, y, 0.2) for y in (11.7, 14.5, 17.5, 20.5)] + [_round(x, 7.6, 0.2) for x in (11.5, 15.0, 18.5)]
    corners = (0, SOUTH_WEST, SOUTH_EAST) if south_eastern_post else (0, SOUTH_WEST)
    posts = [_rotated(_round(7.87, 7.87, 0.08), corner) for corner in corners]
    return (*houses, kiosk, *trees, *posts)


def street_outlines() -> tuple[CornerList, ...]:
    """The static outlines, and the houses beyond them on both sides of all four streets."""
    left = [_row_house(start, end, set_back) for start, end, set_back in FURTHER_HOUSES]
    right = [tuple((x, -y) for x, y in reversed(house)) for house in left]
    return (*static_outlines(), *(_rotated(house, turns) for turns in range(4) for house in (*left, *right)))


def _row_house(start_m: float, end_m: float, set_back_m: float) -> CornerList:
    """A house on the left of the street to the east."""
    front, back = FACADE_M + set_back_m, FACADE_M + set_back_m + FURTHER_HOUSE_DEPTH_M
    return ((start_m, front), (end_m, front), (end_m, back), (start_m, back))


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
