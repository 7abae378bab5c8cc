"""Outlines of road users at the height of the laser: vehicles and walking people."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from gridtrack.common.config import Settings
from gridtrack.common.geometry import wrap_angle
from gridtrack.common.scene import Outline
from gridtrack.simulation.motion import smoothed

FRAME_WIDTH_M = 0.12
RIDER_LENGTH_M = 0.5
CUT_M = {"car": 0.25, "bus": 0.3}
ELLIPSE_CORNERS = 12
STEP_PER_HEIGHT = 0.4
"""Length of a step at the preferred speed, as a share of the height."""
PREFERRED_PER_HEIGHT_HZ = 0.77
"""Preferred speed in heights per second: 1.35 m/s for 1.75 m."""
SPEED_EXPONENT = 0.42
LONGEST_STEP_S = 0.9
"""Slow walkers make shorter steps rather than slower ones."""
STANCE = 0.6
"""Share of its cycle that a foot is on the ground."""
SPEED_STD_S = 0.15
HIP_PER_HEIGHT = 0.53
CROTCH_PER_HEIGHT = 0.47
"""Above this share of the height the cross-section is one torso."""
LEG_CORNERS, TORSO_CORNERS = 8, 12
ARMS_M = (0.7, 1.1)
"""Heights at which the arms hang beside the torso."""
Companion = Literal["nothing", "bag", "trolley", "stroller", "wheelchair", "coat"]


class Walker(Settings):
    """A person's build and companion: something carried, worn, pushed or sat in."""

    height_m: float = Field(default=1.75, ge=0.8, le=2.2)
    apart_m: float = Field(default=0.12, ge=0.0, le=0.6)
    """Lateral distance between the centres of the feet."""
    companion: Companion = "nothing"
    dark: bool = False
    """Whether the clothes reflect little."""
    phase: float = Field(default=0.0, ge=0.0, le=1.0)
    """Phase of the step at the first frame."""


@lru_cache(maxsize=4096)
def body_outline(class_name: str, length_m: float, width_m: float) -> Outline:
    """The outline (N, 2) float32, metres, of a road user, counter-clockwise; the same array for equal arguments.

    Pedestrians are ellipses, cyclists a thin frame with the ellipse of the rider, cars and buses rectangles with cut
    corners, and other classes rectangles.
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
    """Corners on an ellipse with its axes along x and y."""
    angles = [2.0 * math.pi * i / corners for i in range(corners)]
    return [(length_m / 2.0 * math.cos(angle), width_m / 2.0 * math.sin(angle)) for angle in angles]


def _cyclist(length_m: float, width_m: float) -> list[tuple[float, float]]:
    """A thin frame from the rear to the front wheel, with the ellipse of the rider around its middle."""
    rider = min(RIDER_LENGTH_M, length_m)
    frame = min(FRAME_WIDTH_M, width_m)
    # the arc of the rider starts at the intersection of ellipse and frame
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


def step_length_m(speed: NDArray[np.float64], height_m: float) -> NDArray[np.float64]:
    """The length of a step (n,), metres, at speeds (n,), m/s."""
    relative = np.abs(speed) / (PREFERRED_PER_HEIGHT_HZ * height_m)
    return np.minimum(STEP_PER_HEIGHT * height_m * relative**SPEED_EXPONENT, LONGEST_STEP_S * np.abs(speed))


def foot_offset(phase: NDArray[np.float64]) -> NDArray[np.float64]:
    """Offset (n,) of a foot ahead of the body, in strides (two steps), at `phase` (n,) of its cycle.

    The cycle has the length 1 and begins when the foot is set down. On the ground the offset decreases linearly; the
    swing is a cubic with the same slope at both ends, so that the foot is at rest when it leaves and meets the ground.
    """
    phase = np.mod(phase, 1.0)
    reach = STANCE / 2.0
    u = np.clip((phase - STANCE) / (1.0 - STANCE), 0.0, 1.0)
    swing = reach * (6.0 * u**2 - 4.0 * u**3 - 1.0) - (1.0 - STANCE) * (2.0 * u**3 - 3.0 * u**2 + u)
    return np.where(phase < STANCE, reach - phase, swing)


def feet(
    position: NDArray[np.float64], heading: NDArray[np.float64], rate_hz: float, height_m: float, first_phase: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Offsets of the left and the right foot ahead of the body: (n, 2) each, metres, body frame (x forward, y left).

    `position` (n, 2) and `heading` (n,) are the body's in successive frames. The lateral distance of the feet is not
    included. The feet of a standing body are side by side.
    """
    if len(position) < 2:
        return np.zeros((len(position), 2)), np.zeros((len(position), 2))
    velocity = smoothed(np.gradient(position, 1.0 / rate_hz, axis=0), max(SPEED_STD_S * rate_hz, 0.5))
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    stride = 2.0 * step_length_m(speed, height_m)
    cycles = np.divide(speed, stride, out=np.zeros_like(speed), where=stride > 0.0) / rate_hz
    phase = first_phase + np.concatenate([[0.0], np.cumsum((cycles[1:] + cycles[:-1]) / 2.0)])
    direction = wrap_angle(np.arctan2(velocity[:, 1], velocity[:, 0]) - heading)
    along = np.column_stack([np.cos(direction), np.sin(direction)])
    return (
        (stride * foot_offset(phase))[:, None] * along,
        (stride * foot_offset(phase + 0.5))[:, None] * along,
    )


def outlines_of(
    walker: Walker,
    plane_m: float,
    size_m: tuple[float, float],
    position: NDArray[np.float64],
    heading: NDArray[np.float64],
    rate_hz: float,
) -> Iterator[tuple[Outline, ...]]:
    """The cross-section of a walker in a plane `plane_m` above the ground, in each of n frames, body frame.

    `position` (n, 2) and `heading` (n,) are of successive frames; `size_m` are length and width of the torso.
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
    """Outlines of the companion, body frame; a wheelchair's include the sitting person."""
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
    """Large wheels and the shins or thighs of the person, or above them the torso."""
    if plane_m >= 0.6:
        return (_torso(0.3, 0.46),) if plane_m < 1.3 else ()
    wheels_length_m = 2.0 * math.sqrt(max(0.3**2 - (plane_m - 0.3) ** 2, 0.01))
    large = tuple(_box(0.0, y, wheels_length_m, 0.05) for y in (-0.3, 0.3))
    legs_x = 0.5 if plane_m < 0.45 else 0.3
    return (*large, *(_box(legs_x, y, 0.14, 0.12) for y in (-0.1, 0.1)))


def _box(x: float, y: float, length_m: float, width_m: float) -> Outline:
    a, b = length_m / 2.0, width_m / 2.0
    return np.array([(x - a, y - b), (x + a, y - b), (x + a, y + b), (x - a, y + b)], np.float32)
