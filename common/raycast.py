"""Exact traversal of laser beams through the grid: the cells in which a beam has length.

Coordinates are rounded to RESOLUTION_CELLS. A beam or an outline along a grid line is in the upper cells, as is a point
on it, and not in cells that it crosses by a rounding error.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import FRACTION_BITS, GridSpec, Mask, snapped
from gridtrack.common.scan import Scan

snap = numba.njit(cache=True, nogil=True, inline="always")(snapped)
"""`grid.snapped`, for compiled functions."""
MAX_COORDINATE_CELLS, MAX_BEAM_CELLS = 1e9, 1e300
"""Limits of a coordinate and of the length of a beam, in cells. A beam beyond them, or not finite, is ignored."""
Beams = tuple[NDArray[np.float32], NDArray[np.float64], float, float, float, float, float]


def cast_scan(scan: Scan, grid: GridSpec, grid_T_sensor: SE2, visible: Mask, occupied: Mask) -> NDArray[np.float32]:
    """Mark in `visible` and `occupied` (M, M) bool, C-contiguous, the observation of `scan`, and return its points.

    The cells that a beam crosses and its end cell become visible; the end cell of a return becomes occupied.
    Marks are only added, so occupied wins over free and several scans can share the arrays.
    Points are the returns inside the grid window, (N, 2) float32, metres, grid frame.
    """
    points = np.empty((scan.ranges.size, 2), np.float32)
    inside = _cast(
        *_beams(scan, grid, grid_T_sensor),
        visible.reshape(-1),
        occupied.reshape(-1),
        grid.size,
        points,
    )
    return points[:inside] * np.float32(grid.cell_m) + np.array(grid.origin, np.float32)


def end_cells(scan: Scan, grid: GridSpec, grid_T_sensor: SE2) -> NDArray[np.int64]:
    """The cell (B,) of each beam's return, row * M + column; -1 for no return or a return outside the grid.

    They are the occupied cells of `cast_scan`.
    """
    cells = np.empty(scan.ranges.size, np.int64)
    _ends(
        *_beams(scan, grid, grid_T_sensor),
        grid.size,
        cells,
    )
    return cells


def _beams(scan: Scan, grid: GridSpec, grid_T_sensor: SE2) -> Beams:
    """Ranges, directions, range limits, the sensor's position in cells, and the size of a cell in metres."""
    return (
        np.ascontiguousarray(scan.ranges, np.float32),
        turned(directions_of(scan.angle_min, scan.angle_increment, scan.ranges.size), grid_T_sensor.theta),
        scan.range_min,
        scan.range_max,
        snapped((grid_T_sensor.x - grid.origin[0]) / grid.cell_m),
        snapped((grid_T_sensor.y - grid.origin[1]) / grid.cell_m),
        grid.cell_m,
    )


@lru_cache(maxsize=64)
def directions_of(angle_0: float, angle_step: float, beams: int) -> NDArray[np.float64]:
    """Unit vectors (B, 2) of the beams, sensor frame: the same for every scan of a sensor."""
    angles = angle_0 + angle_step * np.arange(beams)
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


def turned(directions: NDArray[np.float64], theta: float) -> NDArray[np.float64]:
    """Unit vectors (B, 2) turned by `theta`; unchanged to the last bit if it is 0."""
    if theta == 0.0:
        return directions
    c, s = np.cos(theta), np.sin(theta)  # NaN, not an error, for an angle that is not finite
    x, y = directions.T
    return np.stack([c * x - s * y, s * x + c * y], axis=1)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _cast(ranges, directions, range_min, range_max, x0, y0, cell_m, visible, occupied, size, points):  # type: ignore[no-untyped-def]
    """Cast all beams; coordinates in cells, from the lower-left corner. Returns the number of points.

    Checks for values that are not finite: with them the traversal would write outside the arrays.
    """
    inside = 0
    if not abs(x0) + abs(y0) < MAX_COORDINATE_CELLS:
        return inside
    for i in range(ranges.size):
        distance = float(ranges[i])
        if math.isnan(distance) or distance < range_min:
            continue
        length = min(distance, range_max) / cell_m
        dx, dy = directions[i, 0] * length, directions[i, 1] * length
        if not abs(dx) + abs(dy) < MAX_BEAM_CELLS:
            continue
        cross(x0, y0, dx, dy, size, visible)
        row, column = math.floor(snap(y0 + dy)), math.floor(snap(x0 + dx))
        if 0 <= row < size and 0 <= column < size:
            visible[row * size + column] = True
            if distance <= range_max:
                occupied[row * size + column] = True
                points[inside, 0], points[inside, 1] = x0 + dx, y0 + dy
                inside += 1
    return inside


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _ends(ranges, directions, range_min, range_max, x0, y0, cell_m, size, cells):  # type: ignore[no-untyped-def]
    """Cells in which the beams end; coordinates in cells, from the lower-left corner, with `_cast`'s arithmetic."""
    reachable = abs(x0) + abs(y0) < MAX_COORDINATE_CELLS
    for i in range(ranges.size):
        cells[i] = -1
        distance = float(ranges[i])
        if not reachable or not range_min <= distance <= range_max:
            continue
        length = distance / cell_m
        dx, dy = directions[i, 0] * length, directions[i, 1] * length
        if not abs(dx) + abs(dy) < MAX_BEAM_CELLS:
            continue
        row, column = math.floor(snap(y0 + dy)), math.floor(snap(x0 + dx))
        if 0 <= row < size and 0 <= column < size:
            cells[i] = row * size + column


@numba.njit(cache=True, nogil=True, error_model="numpy")
def cross(x0, y0, dx, dy, size, visible):  # type: ignore[no-untyped-def]
    """Mark the cells in which the segment from (x0, y0) to (x0 + dx, y0 + dy) has length."""
    enter, leave = clip(x0, y0, dx, dy, size)
    if enter >= leave or (dx == 0.0 and dy == 0.0):
        return
    if abs(dx) >= abs(dy):
        _cross_slabs(x0, y0, dx, dy, enter, leave, size, 1, size, visible)
    else:
        _cross_slabs(y0, x0, dy, dx, enter, leave, size, size, 1, visible)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _cross_slabs(u0, v0, du, dv, enter, leave, size, stride_u, stride_v, visible):  # type: ignore[no-untyped-def]
    """Traverse the unit slabs of the axis u along which the segment is longer, so |dv/du| <= 1.

    Within one slab the segment crosses one or two cells: where it enters and where it leaves. From slab to slab it
    leaves one cell and enters the next at the same v; a segment through a corner crosses the two cells in which it has
    length, not their neighbours. v is in fixed point (2^-40 of a cell), so that the fast loop has no branch and no
    conversion.
    """
    slope = dv / du
    first, last = snap(u0 + enter * du), snap(u0 + leave * du)
    if du < 0.0:
        first, last = last, first
    if first == last:
        return
    step = _fixed(slope)
    rising, falling = int(step > 0), int(step < 0)
    top = (size << FRACTION_BITS) - 1
    slab = min(max(math.floor(first), 0), size - 1)
    crossings = min(max(math.ceil(last) - 1, slab), size - 1) - slab
    base = slab * stride_u
    cell = min(max(_fixed(v0 + slope * (first - u0)) - falling, 0), top) >> FRACTION_BITS
    visible[np.uint64(base + cell * stride_v)] = True
    v = _inside(_fixed(v0 + slope * (slab + 1 - u0)), step, crossings, top)
    for _ in range(crossings):
        visible[np.uint64(base + ((v - rising) >> FRACTION_BITS) * stride_v)] = True
        base += stride_u
        visible[np.uint64(base + ((v - falling) >> FRACTION_BITS) * stride_v)] = True
        v += step
    cell = min(max(_fixed(v0 + slope * (last - u0)) - rising, 0), top) >> FRACTION_BITS
    visible[np.uint64(base + cell * stride_v)] = True


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _inside(v, step, crossings, top):  # type: ignore[no-untyped-def]
    """`v`, moved if a rounding error would carry one of `v + k * step`, 0 <= k < crossings, outside of 1 to `top`.

    The lower limit is 1 because a step up or down takes 1 from v; without a step it is 0. Between the limits lie at
    most size - 2 cells, so there is always room.
    """
    travel = (crossings - 1) * step
    if step > 0:
        return min(max(v, 1), top - travel)
    if step < 0:
        return max(min(v, top), 1 - travel)
    return min(max(v, 0), top)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _fixed(v):  # type: ignore[no-untyped-def]
    """A coordinate in cells as a 64-bit integer with FRACTION_BITS binary places."""
    return np.int64(round(v * (1 << FRACTION_BITS)))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def first_cell(at, along, size):  # type: ignore[no-untyped-def]
    """Row or column of the cell in which a beam begins, or enters the grid; on a grid line the cell ahead."""
    at = snap(at)
    cell = math.ceil(at) - 1 if along < 0.0 else math.floor(at)
    return min(max(cell, 0), size - 1)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def clip(x0, y0, dx, dy, size):  # type: ignore[no-untyped-def]
    """The part [enter, leave] of the segment, as shares of its length, inside the grid (Liang and Barsky, 1984)."""
    enter, leave = 0.0, 1.0
    for start, along in ((x0, dx), (y0, dy)):
        if along == 0.0:
            if start < 0.0 or start >= size:
                return 1.0, 0.0
            continue
        near, far = (0.0 - start) / along, (size - start) / along
        enter, leave = max(enter, min(near, far)), min(leave, max(near, far))
    return enter, leave


def window_ranges(
    start: NDArray[np.float64], directions: NDArray[np.float64], longest: float, size: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Ranges (B,) at which beams from `start` (2,) enter and leave the grid, up to `longest`; all in cells.

    A beam that misses the grid leaves it before it enters.
    """
    ranges: NDArray[np.float64] = np.empty((2, len(directions)))
    _clip_all(start[0], start[1], np.ascontiguousarray(directions), longest, size, ranges)
    return ranges[0], ranges[1]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _clip_all(x0, y0, directions, longest, size, ranges):  # type: ignore[no-untyped-def]
    """Set the ranges (2, B) of `window_ranges`."""
    for i in range(directions.shape[0]):
        enter, leave = clip(x0, y0, directions[i, 0] * longest, directions[i, 1] * longest, size)
        ranges[0, i], ranges[1, i] = enter * longest, leave * longest
