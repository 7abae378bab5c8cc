"""Motion: smoothed paths, headings, unbroken tracks, and wheel odometry."""

from __future__ import annotations

import itertools
import math

import numba
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from gridtrack.common.config import Settings
from gridtrack.common.geometry import wrap_angle

STANDING_M_S = 0.25
"""Below this speed the last heading is kept."""


def smoothed(values: NDArray[np.float64], std_steps: float) -> NDArray[np.float64]:
    """`values` (n, d), one row per step, smoothed by a Gaussian of `std_steps`, normalised at the ends."""
    reach = int(np.ceil(4.0 * std_steps))
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / std_steps) ** 2)
    total = np.convolve(np.ones(len(values)), weights)[reach : reach + len(values)]
    columns = [np.convolve(column, weights)[reach : reach + len(values)] / total for column in values.T]
    return np.stack(columns, axis=1)


def headings(
    position: NDArray[np.float64], step_s: float, std_steps: float, resting: float = 0.0
) -> NDArray[np.float64]:
    """The smoothed direction of the velocity, (n,) radians, for positions (n, 2); kept while the body is at rest.

    Before the first motion it is the direction of that motion; without any motion it is `resting`.
    """
    if len(position) < 2:
        return np.full(len(position), resting)
    velocity = np.gradient(position, step_s, axis=0)
    moving = np.hypot(velocity[:, 0], velocity[:, 1]) > STANDING_M_S
    if not moving.any():
        return np.full(len(position), resting)
    last_moving = np.maximum.accumulate(np.where(moving, np.arange(len(position)), -1))
    last_moving[last_moving < 0] = np.argmax(moving)
    direction = np.arctan2(velocity[:, 1], velocity[:, 0])[last_moving]
    return smoothed(np.unwrap(direction)[:, None], std_steps)[:, 0]


@numba.njit(cache=True, nogil=True)
def trailing_headings(front, trail, heading_0):  # type: ignore[no-untyped-def]
    """Headings (n,) radians of a vehicle with its front on `front` (n, 2).

    The rear wheels, `trail` metres behind, follow the front (tractrix): the vehicle turns only while it moves.
    """
    found = np.empty(len(front))
    x, y = front[0, 0] - trail * math.cos(heading_0), front[0, 1] - trail * math.sin(heading_0)
    for i in range(len(front)):
        found[i] = math.atan2(front[i, 1] - y, front[i, 0] - x)
        x, y = front[i, 0] - trail * math.cos(found[i]), front[i, 1] - trail * math.sin(found[i])
    return found


def unbroken_tracks(user: NDArray[np.int64], step: NDArray[np.int64]) -> list[slice]:
    """The rows of each unbroken track, for rows sorted by user and step."""
    breaks = np.flatnonzero((np.diff(user) != 0) | (np.diff(step) != 1)) + 1
    edges = [0, *breaks.tolist(), len(user)]
    return [slice(first, end) for first, end in itertools.pairwise(edges) if end > first]


class WheelOdometry(Settings):
    """Errors of wheel odometry; the same seed and path give the same errors.

    The defaults are as measured on an indoor robot with a track width of about 0.4 m, see docs/drives.md.
    """

    seed: int = Field(default=0, ge=0, lt=1 << 63)
    track_width_m: float = Field(default=0.4, gt=0.0, le=10.0)
    """Distance between the left and the right wheel."""
    wheel_std: float = Field(default=0.004, ge=0.0, le=1.0)
    """Standard deviation of a wheel's distance after one metre; it grows with the square root of the distance."""
    turn_std: float = Field(default=0.07, ge=0.0, le=1.0)
    """Standard deviation of the heading after a turn of one radian; it grows with the square root of the angle."""
    diameter_std: float = Field(default=0.002, ge=0.0, le=0.1)
    """Standard deviation of the relative difference of the wheel diameters; constant in a recording."""

    def scaled(self, factor: float) -> WheelOdometry:
        """All errors multiplied by `factor`. Raises pydantic's ValidationError beyond the limits."""
        errors = ("wheel_std", "turn_std", "diameter_std")
        return WheelOdometry(**self.model_dump() | {name: getattr(self, name) * factor for name in errors})

    def recorded(self, poses: NDArray[np.float64]) -> NDArray[np.float64]:
        """The poses (n, 3) by odometry for the true `poses` (n, 3): x, y, heading, metres and radians.

        The first pose is exact.
        """
        random = np.random.default_rng(self.seed)
        bend = self.diameter_std / self.track_width_m * random.standard_normal()
        step, angle = np.diff(poses[:, :2], axis=0), wrap_angle(np.diff(poses[:, 2]))
        distance = np.hypot(step[:, 0], step[:, 1])
        left, right = self.wheel_std * np.sqrt(distance) * random.standard_normal((2, len(distance)))
        slip = self.turn_std * np.sqrt(np.abs(angle)) * random.standard_normal(len(distance))
        turned = (right - left) / self.track_width_m + slip + bend * distance
        longer = np.divide((left + right) / 2.0, distance, out=np.zeros_like(distance), where=distance > 0.0)
        heading = poses[0, 2] + np.concatenate([[0.0], np.cumsum(angle + turned)])
        # the step in the body frame at its start, applied at half of the heading error of the step
        ahead = np.arctan2(step[:, 1], step[:, 0]) - poses[:-1, 2] + heading[:-1] + turned / 2.0
        measured = (distance * (1.0 + longer))[:, None] * np.column_stack([np.cos(ahead), np.sin(ahead)])
        position = poses[0, :2] + np.concatenate([np.zeros((1, 2)), np.cumsum(measured, axis=0)])
        return np.column_stack([position, heading])
