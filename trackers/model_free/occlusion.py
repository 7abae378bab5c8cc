"""Occlusion: the returns at which an occluder may hide the continuation of a surface.

Where a nearer object cuts a surface off, the last return is the end of that object and not of the surface (Petrovskaya
and Thrun, Autonomous Robots 2009, section 4, for vehicles): it must not be matched as the end of the surface.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import GridFrame, GridSpec, Mask

BEARINGS = 1440
"""Number of bearing bins around a sensor."""
NO_RETURN, BACKGROUND = -2, -1
"""Label of a bearing without a return, and of a return outside all clusters."""


def cut_off_returns(frame: GridFrame, grid: GridSpec, labels: NDArray[np.int64]) -> Mask:
    """Which returns of the frame (N,) have a hidden neighbour cell that their own cluster does not hide.

    `labels` (N,) are cluster numbers, or BACKGROUND. Cells outside the grid count as hidden.
    """
    cut = np.zeros(len(frame.points), np.bool_)
    for sensor, origin in enumerate(frame.origins):
        own = frame.point_origin == sensor
        points = (frame.points[own] - origin).astype(np.float64)
        corner = np.array(grid.origin) - origin
        cut[own] = _cut_off(points, labels[own], frame.visible, corner, grid.cell_m)
    return cut


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _cut_off(points, labels, visible, corner, cell_m):  # type: ignore[no-untyped-def]
    """`cut_off_returns` for one sensor at (0, 0), with the lower-left corner of the grid at `corner` (2,)."""
    ranges, nearest = _first_returns(points, labels, cell_m)
    size = len(visible)
    cut = np.zeros(len(points), np.bool_)
    for i in range(len(points)):
        if labels[i] == BACKGROUND:
            continue
        column, row = math.floor((points[i, 0] - corner[0]) / cell_m), math.floor((points[i, 1] - corner[1]) / cell_m)
        for k in range(9):
            r, c = row + k // 3 - 1, column + k % 3 - 1
            if not (0 <= r < size and 0 <= c < size):
                cut[i] = True
            elif not visible[r, c]:
                x, y = corner[0] + (c + 0.5) * cell_m, corner[1] + (r + 0.5) * cell_m
                b = _bearing_bin(math.atan2(y, x))
                if not (nearest[b] == labels[i] and ranges[b] <= math.hypot(x, y)):
                    cut[i] = True
    return cut


@numba.njit(error_model="numpy")
def _first_returns(points, labels, cell_m):  # type: ignore[no-untyped-def]
    """Range and label (BEARINGS,) of the nearest return in each bearing bin; a return is one cell wide."""
    ranges, nearest = np.full(BEARINGS, np.inf), np.full(BEARINGS, NO_RETURN)
    for i in range(len(points)):
        away = max(math.hypot(points[i, 0], points[i, 1]), 1e-6)
        bearing, half = math.atan2(points[i, 1], points[i, 0]), math.atan2(0.6 * cell_m, away)
        first = math.floor((bearing - half) / (2.0 * math.pi) * BEARINGS)
        last = math.floor((bearing + half) / (2.0 * math.pi) * BEARINGS)
        for b in range(first, last + 1):
            if away < ranges[b % BEARINGS]:
                ranges[b % BEARINGS], nearest[b % BEARINGS] = away, labels[i]
    return ranges, nearest


@numba.njit(error_model="numpy")
def _bearing_bin(bearing):  # type: ignore[no-untyped-def]
    return math.floor(bearing / (2.0 * math.pi) * BEARINGS) % BEARINGS
