"""From simulated or annotated positions to smooth motion: smoothed positions, and headings that do not flip."""

from __future__ import annotations

import itertools
import math

import numba
import numpy as np
from numpy.typing import NDArray

STANDING_M_S = 0.25
"""Below this speed the velocity gives no heading, and the last heading is kept."""


def smoothed(values: NDArray[np.float64], std_steps: float) -> NDArray[np.float64]:
    """`values` (n, d), one row a step, smoothed by a Gaussian of `std_steps`, normalised at the ends."""
    reach = int(np.ceil(4.0 * std_steps))
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / std_steps) ** 2)
    total = np.convolve(np.ones(len(values)), weights)[reach : reach + len(values)]
    columns = [np.convolve(column, weights)[reach : reach + len(values)] / total for column in values.T]
    return np.stack(columns, axis=1)


def headings(
    position: NDArray[np.float64], step_s: float, std_steps: float, resting: float = 0.0
) -> NDArray[np.float64]:
    """The direction of the velocity, (n,) radians, for positions (n, 2), smoothed; kept while the body stands.

    Before the first motion it is the direction of the first motion; for a body that never moves it is `resting`.
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
    """Headings (n,) radians of a vehicle whose front moves along `front` (n, 2), with rear wheels `trail` metres behind
    it that follow (the tractrix): it turns only while it moves."""
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
