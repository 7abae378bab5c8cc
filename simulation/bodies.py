"""Outlines of road users at the height of the laser, in their own frame: x forward, origin at the centre."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from gridtrack.common.scene import Outline

FRAME_WIDTH_M = 0.12
RIDER_LENGTH_M = 0.5
CUT_M = {"car": 0.25, "bus": 0.3}
ELLIPSE_CORNERS = 12


@lru_cache(maxsize=4096)
def body_outline(class_name: str, length_m: float, width_m: float) -> Outline:
    """The outline (N, 2) float32, metres, of a road user, counter-clockwise; the same array for equal arguments.

    Pedestrians are ellipses, cyclists a thin frame with the rider's ellipse on it, cars and buses rectangles with cut
    corners; any other class is a rectangle.
    """
    if class_name == "pedestrian":
        corners = ellipse(length_m, width_m, ELLIPSE_CORNERS)
    elif class_name == "cyclist":
        corners = _cyclist(length_m, width_m)
    else:
        corners = _cut_rectangle(length_m, width_m, CUT_M.get(class_name, 0.0))
    outline = np.array(corners, np.float32)
    outline.flags.writeable = False
    return outline


def ellipse(length_m: float, width_m: float, corners: int) -> list[tuple[float, float]]:
    """Corners on an ellipse whose axes lie along x and y."""
    angles = [2.0 * math.pi * i / corners for i in range(corners)]
    return [(length_m / 2.0 * math.cos(angle), width_m / 2.0 * math.sin(angle)) for angle in angles]


def _cyclist(length_m: float, width_m: float) -> list[tuple[float, float]]:
    """A thin frame from the rear to the front wheel, with the rider's ellipse around its middle."""
    rider = min(RIDER_LENGTH_M, length_m)
    frame = min(FRAME_WIDTH_M, width_m)
    # The rider's arc starts where the ellipse leaves the frame.
    leave = math.asin(frame / width_m)
    arc = [leave + (math.pi - 2.0 * leave) * i / 4.0 for i in range(5)]
    left = [(rider / 2.0 * math.cos(angle), width_m / 2.0 * math.sin(angle)) for angle in arc]
    left = [(length_m / 2.0, frame / 2.0), *left, (-length_m / 2.0, frame / 2.0)]
    return left + [(x, -y) for x, y in reversed(left)]


def _cut_rectangle(length_m: float, width_m: float, cut_m: float) -> list[tuple[float, float]]:
    x, y = length_m / 2.0, width_m / 2.0
    cut = min(cut_m, x, y)
    if cut == 0.0:
        return [(x, -y), (x, y), (-x, y), (-x, -y)]
    return [
        *((x, cut - y), (x, y - cut), (x - cut, y), (cut - x, y)),
        *((-x, y - cut), (-x, cut - y), (cut - x, -y), (x - cut, -y)),
    ]
