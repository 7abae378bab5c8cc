"""Cells that a laser sees among occupied ones: those that a straight line reaches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def cells_in_sight(occupied: NDArray[np.uint8], laser: NDArray[np.float64]) -> NDArray[np.bool_]:
    """The cells (T, M, M) that no cell of `occupied` (T, M, M) hides from the `laser` (2,), at a column and a row.

    `laser` is in cells, (0.5, 0.5) in the middle of the first one; it may be outside of the window. A cell is hidden if
    every line from the laser to the edge of the window meets an occupied cell more than one cell before it: so a side
    that is seen from its end is seen whole.
    """
    steps, size = len(occupied), occupied.shape[-1]
    lines = _lines_from(laser, size)
    cells = np.zeros((steps, size * size + 1), bool)  # the last one is for all that is outside
    cells[:, :-1] = occupied.reshape(steps, -1)
    met = np.logical_or.accumulate(cells[:, lines], axis=2)
    met[:, :, 2:] = met[:, :, :-2].copy()
    met[:, :, :2] = False
    in_sight = np.zeros_like(cells)
    step, line, number = np.nonzero(~met)
    in_sight[step, lines[line, number]] = True
    return in_sight[:, :-1].reshape(occupied.shape)


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
