"""Cells that a laser sees among occupied ones: those that a straight line reaches."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray


def cells_in_sight(occupied: NDArray[np.uint8], laser: NDArray[np.float64]) -> NDArray[np.bool_]:
    """The cells (T, M, M) that no cell of `occupied` (T, M, M) hides from the `laser` (2,), at a column and a row.

    `laser` is in cells, (0.5, 0.5) in the middle of the first one; it may be outside of the window. A cell is hidden if
    every line from the laser to the edge of the window meets an occupied cell more than one cell before it: so a side
    that is seen from its end is seen whole.
    """
    seen = np.zeros(occupied.shape, np.bool_)
    steps, size = len(occupied), occupied.shape[-1]
    _see_along(_lines_from(laser, size), occupied.reshape(steps, -1), seen.reshape(steps, -1))
    return seen


@numba.njit(cache=True, nogil=True)
def _see_along(lines: NDArray[np.intp], occupied: NDArray[np.uint8], seen: NDArray[np.bool_]) -> None:
    """Mark in `seen` (T, M * M) the cells of each line (L, K) as far as one behind its first occupied one."""
    outside = occupied.shape[1]
    for step in range(len(occupied)):
        for line in lines:
            last = len(line) - 1
            for number, cell in enumerate(line):
                if number > last:
                    break
                if cell == outside:
                    continue
                seen[step, cell] = True
                if occupied[step, cell]:
                    last = min(last, number + 1)


def _lines_from(laser: NDArray[np.float64], size: int) -> NDArray[np.intp]:
    """The numbers (L, K) of the cells on the line to each cell of the edge, nearest first; M * M outside the window."""
    along = np.arange(size)
    ends = [np.stack([along, np.full(size, side)]) for side in (0, size - 1)]
    edge = np.concatenate([*ends, *(end[::-1] for end in ends)], axis=1)[:, :, None]  # columns and rows (2, L, 1)
    way = laser[:, None, None] - 0.5 - edge
    longest = np.maximum(np.abs(way).max(axis=0), 1e-9)  # cells
    back = np.arange(int(longest.max()), -1, -1)  # from the edge, cells
    column, row = np.rint(edge + way / longest * back).astype(int)
    inside = (back <= longest) & (row >= 0) & (row < size) & (column >= 0) & (column < size)
    return np.where(inside, row * size + column, size * size)
