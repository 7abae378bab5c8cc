"""What a laser at a given height sees of a person: two legs, a torso with arms, and what the person has along.

Shin and thigh are 6 to 10 % of the height thick (D. A. Winter, "Biomechanics and Motor Control of Human Movement",
4th edition, 2009, and trousers).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from gridtrack.common.config import Settings
from gridtrack.common.scene import Outline
from gridtrack.simulation.bodies import ellipse
from gridtrack.simulation.gait import HIP_PER_HEIGHT, feet

CROTCH_PER_HEIGHT = 0.47
"""Above this share of the height a body is one torso."""
LEG_CORNERS, TORSO_CORNERS = 8, 12
Companion = Literal["nothing", "bag", "trolley", "stroller", "wheelchair", "coat"]
ARMS_M = (0.7, 1.1)
"""Heights at which the arms hang beside the torso."""


class Walker(Settings):
    """A person's build, and what the person carries, wears, pushes or sits in."""

    height_m: float = Field(default=1.75, ge=0.8, le=2.2)
    apart_m: float = Field(default=0.12, ge=0.0, le=0.6)
    """Between the middles of the feet, across."""
    companion: Companion = "nothing"
    dark: bool = False
    """Whether the clothes reflect little."""
    phase: float = Field(default=0.0, ge=0.0, le=1.0)
    """Of the step at the first frame."""


def outlines_of(
    walker: Walker,
    plane_m: float,
    size_m: tuple[float, float],
    position: NDArray[np.float64],
    heading: NDArray[np.float64],
    rate_hz: float,
) -> Iterator[tuple[Outline, ...]]:
    """What a horizontal plane `plane_m` above the ground cuts of a walker in each of n frames, in the body's frame.

    `position` (n, 2) and `heading` (n,) of successive frames; `size_m` are length and width of the torso.
    """
    along = _companion(walker.companion, plane_m, size_m)
    if walker.companion == "wheelchair":
        yield from (along for _ in position)
        return
    left, right = feet(position, heading, rate_hz, walker.height_m, walker.phase)
    hip_m = HIP_PER_HEIGHT * walker.height_m
    if plane_m < CROTCH_PER_HEIGHT * walker.height_m and walker.companion != "coat":
        upright = 1.0 - plane_m / hip_m
        leg = _leg(walker.height_m, plane_m)
        aside = (0.0, walker.apart_m / 2.0)
        for a, b in zip((left * upright + aside).tolist(), (right * upright - aside).tolist(), strict=True):
            yield (_moved(leg, a), _moved(leg, b), *along)
        return
    torso = _torso(*size_m)
    if not ARMS_M[0] <= plane_m <= ARMS_M[1]:
        yield from ((torso, *along) for _ in position)
        return
    arm, aside = _ellipse(0.1, 0.09, LEG_CORNERS), (0.0, size_m[1] / 2.0 + 0.07)
    for a, b in zip((right * 0.4 + aside).tolist(), (left * 0.4 - aside).tolist(), strict=True):
        yield (torso, _moved(arm, a), _moved(arm, b), *along)


def _moved(outline: Outline, by: list[float]) -> Outline:
    return outline + np.array(by, np.float32)


@lru_cache(maxsize=1024)
def _leg(height_m: float, plane_m: float) -> Outline:
    across = height_m * (0.06 + 0.045 * plane_m / (HIP_PER_HEIGHT * height_m))
    return _ellipse(1.2 * across, across, LEG_CORNERS)


@lru_cache(maxsize=1024)
def _torso(length_m: float, width_m: float) -> Outline:
    return _ellipse(length_m, width_m, TORSO_CORNERS)


def _ellipse(length_m: float, width_m: float, corners: int) -> Outline:
    return np.array(ellipse(length_m, width_m, corners), np.float32)


@lru_cache(maxsize=1024)
def _companion(companion: Companion, plane_m: float, size_m: tuple[float, float]) -> tuple[Outline, ...]:
    """Outlines in the body's frame of what is beside the body; a wheelchair's are the sitting person's too."""
    side = size_m[1] / 2.0
    if companion == "wheelchair":
        return _wheelchair(plane_m)
    if companion == "bag" and 0.25 <= plane_m <= 0.75:
        return (_box(0.0, side + 0.08, 0.32, 0.12),)
    if companion == "trolley" and plane_m <= 0.6:
        return (_box(-0.6, side, 0.25, 0.38),)
    if companion == "stroller" and plane_m < 1.0:
        wheels = [_box(x, y, 0.2, 0.05) for x in (0.45, 1.0) for y in (-0.25, 0.25)]
        return tuple(wheels) if plane_m < 0.3 else (_box(0.75, 0.0, 0.8, 0.48),)
    return ()


def _wheelchair(plane_m: float) -> tuple[Outline, ...]:
    """Large wheels and the shins or thighs of who sits in it, or the torso above them."""
    if plane_m >= 0.6:
        return (_torso(0.3, 0.46),) if plane_m < 1.3 else ()
    wheels_length_m = 2.0 * math.sqrt(max(0.3**2 - (plane_m - 0.3) ** 2, 0.01))
    large = tuple(_box(0.0, y, wheels_length_m, 0.05) for y in (-0.3, 0.3))
    legs_x = 0.5 if plane_m < 0.45 else 0.3
    return (*large, *(_box(legs_x, y, 0.14, 0.12) for y in (-0.1, 0.1)))


def _box(x: float, y: float, length_m: float, width_m: float) -> Outline:
    a, b = length_m / 2.0, width_m / 2.0
    return np.array([(x - a, y - b), (x + a, y - b), (x + a, y + b), (x - a, y + b)], np.float32)
