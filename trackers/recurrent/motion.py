"""Motion in training windows: windows of moving shapes, and the cells that something entered.

In most windows of a recording hardly anything moves, and a network that holds every cell where it is has nearly the
least loss: from recordings alone it leaves that state after thousands of updates, from dense motion after hundreds.
Entered cells are found from the frames alone, as `fit` has no truth.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

MOST, FEWEST = 40, 13
"""Number of shapes."""
RADII = (0.6, 3.0)
"""Radii of discs, and half widths of rectangles before their random factors, cells; log-uniform."""
SPEEDS = (0.15, 2.0)
"""Speeds, cells a step, log-uniform: a walk in cells of 0.1 to 0.2 m and steps of a tenth of a second."""
STANDING_SHAPES, HIDING_SHAPES, RECTANGLES, LOST_SHARE = 0.25, 0.2, 0.3, 0.1
"""Shares of the shapes that stand, that hide cells behind them, and that are rectangles; share of the points that the
laser misses."""
LASER_RANGES = (0.7, 2.5)
"""Ranges of the laser, in sides of the window."""
TURN = 0.01
"""Standard deviation of the turn in a step, rad."""
SPACING = 0.5
"""Distance of the points on an outline, cells."""

LOOKBACK_STEPS = 10
"""A cell is entered if it is occupied, and was free so many steps before, with its neighbours."""
NEAR_CELLS = 4
"""Greatest distance in rows and in columns from an entered cell to one near it."""
STANDING_SHARE = 0.3
"""A cell that is occupied in a larger share of the frames that see it belongs to a standing object."""


class Contour(NamedTuple):
    """Points (2, P) of an outline about its centre, cells, and the directions (2, P) in which it faces there."""

    points: NDArray[np.float64]
    normals: NDArray[np.float64]


class Path(NamedTuple):
    """Position (2, T), cells, and heading (T,) of a shape."""

    position: NDArray[np.float64]
    heading: NDArray[np.float64]


def moving_shapes(draw: np.random.Generator, steps: int, size: int) -> NDArray[np.uint8]:
    """The planes (steps, 2, size, size), visible and occupied, of shapes that stand or move nearly straight on.

    One laser sees them, at a random place and as far as its range: not the sides that face away from it, and not a
    share of the points. Some of the shapes hide cells behind them; if all did, hardly any motion would be visible.
    """
    occupied, opaque = np.zeros((2, steps, size, size), np.uint8)
    laser = draw.uniform(-size / 2, 1.5 * size, 2)
    for _ in range(int(draw.integers(FEWEST, MOST + 1))):
        shape = _shape(draw, steps, size, laser[:, None, None])
        occupied |= shape
        if draw.random() < HIDING_SHAPES:
            opaque |= shape
    row, column = np.mgrid[:size, :size] + 0.5
    reached = np.hypot(column - laser[0], row - laser[1]) <= draw.uniform(*LASER_RANGES) * size
    visible = (reached & cells_in_sight(opaque, laser)).astype(np.uint8)
    return np.stack([visible, visible & occupied], axis=1)


def _shape(draw: np.random.Generator, steps: int, size: int, laser: NDArray[np.float64]) -> NDArray[np.uint8]:
    """The occupied cells (steps, size, size) of one shape in full view of the `laser` (2, 1, 1)."""
    outline, path = _outline(draw), _path(draw, steps, size)
    cosine, sine = np.cos(path.heading), np.sin(path.heading)
    rotation = np.array([[cosine, -sine], [sine, cosine]])  # (2, 2, T)
    points = path.position[:, :, None] + np.einsum("ijt,jp->itp", rotation, outline.points)
    facing = np.einsum("ijt,jp->itp", rotation, outline.normals) * (laser - points)
    column, row = np.floor(points).astype(int)
    seen = (facing.sum(axis=0) > 0) & (draw.random(row.shape) >= LOST_SHARE)
    seen &= (row >= 0) & (row < size) & (column >= 0) & (column < size)
    step = np.broadcast_to(np.arange(steps)[:, None], row.shape)
    occupied = np.zeros((steps, size, size), np.uint8)
    occupied[step[seen], row[seen], column[seen]] = 1
    return occupied


def _outline(draw: np.random.Generator) -> Contour:
    radius = _log_uniform(draw, RADII)
    if draw.random() < RECTANGLES:
        half = np.array([radius * draw.uniform(2.0, 4.0), radius * draw.uniform(0.8, 2.0)])
        sides = [_side(half, axis, sign) for axis in (0, 1) for sign in (-1.0, 1.0)]
        return Contour(*(np.concatenate(part, axis=1) for part in zip(*sides, strict=True)))
    angle = np.arange(0.0, 2.0 * np.pi, SPACING / radius)
    directions = np.stack([np.cos(angle), np.sin(angle)])
    return Contour(radius * directions, directions)


def _side(half: NDArray[np.float64], axis: int, sign: float) -> Contour:
    """The side of a rectangle that faces along `axis`; `half` (2,) of its length and width."""
    along = np.arange(-half[1 - axis], half[1 - axis], SPACING)
    points, normals = np.empty((2, len(along))), np.zeros((2, len(along)))
    points[axis], points[1 - axis], normals[axis] = sign * half[axis], along, sign
    return Contour(points, normals)


def _path(draw: np.random.Generator, steps: int, size: int) -> Path:
    """Nearly straight on; halfway at a random place of the window."""
    speed = 0.0 if draw.random() < STANDING_SHAPES else _log_uniform(draw, SPEEDS)
    heading = draw.uniform(0.0, 2.0 * np.pi) + draw.normal(0.0, TURN) * np.arange(steps, dtype=np.float64)
    way = np.cumsum(speed * np.stack([np.cos(heading), np.sin(heading)]), axis=1)
    return Path(draw.uniform(0.0, size, (2, 1)) + way - way[:, [steps // 2]], heading)


def _log_uniform(draw: np.random.Generator, bounds: tuple[float, float]) -> float:
    return float(np.exp(draw.uniform(*np.log(bounds))))


def cells_in_sight(occupied: NDArray[np.uint8], laser: NDArray[np.float64]) -> NDArray[np.bool_]:
    """The cells (T, M, M) that no cell of `occupied` (T, M, M) hides from the `laser` (2,): column and row.

    `laser` is in cells, (0.5, 0.5) in the middle of the first one; it may be outside of the window. A cell is hidden if
    every line from the laser to the edge of the window meets an occupied cell more than one cell before it.
    """
    seen = np.zeros(occupied.shape, np.bool_)
    steps, size = len(occupied), occupied.shape[-1]
    _see_along(_lines_from(laser, size), occupied.reshape(steps, -1), seen.reshape(steps, -1))
    return seen


@numba.njit(cache=True, nogil=True)
def _see_along(lines: NDArray[np.intp], occupied: NDArray[np.uint8], seen: NDArray[np.bool_]) -> None:
    """Mark in `seen` (T, M * M) the cells of each line (L, K), up to one behind its first occupied cell."""
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
    """The numbers (L, K) of the cells on the line to each cell of the edge, nearest first; M * M: no cell."""
    along = np.arange(size)
    ends = [np.stack([along, np.full(size, side)]) for side in (0, size - 1)]
    edge = np.concatenate([*ends, *(end[::-1] for end in ends)], axis=1)[:, :, None]  # columns and rows (2, L, 1)
    way = laser[:, None, None] - 0.5 - edge
    longest = np.maximum(np.abs(way).max(axis=0), 1e-9)  # cells
    back = np.arange(int(longest.max()), -1, -1)  # from the edge, cells
    column, row = np.rint(edge + way / longest * back).astype(int)
    inside = (back <= longest) & (row >= 0) & (row < size) & (column >= 0) & (column < size)
    return np.where(inside, row * size + column, size * size)


def entered_cells(windows: Tensor) -> Tensor:
    """The cells (B, T, M, M) bool of `windows` (B, T, 2, M, M) bool that something entered within LOOKBACK_STEPS.

    There are none in the first of these steps. Cells of standing objects, and the cells around them, in which range
    noise comes and goes, are left out.
    """
    return _entered(windows, _standing(windows))


def near_entered_cells(windows: Tensor) -> Tensor:
    """The cells (B, T, M, M) bool at most NEAR_CELLS from an entered one, in the same frame."""
    standing = _standing(windows)
    return _widened(_entered(windows, standing), NEAR_CELLS) & ~standing


def _entered(windows: Tensor, standing: Tensor) -> Tensor:
    visible, occupied = windows.unbind(dim=2)
    entered = torch.zeros_like(occupied)
    if windows.shape[1] > LOOKBACK_STEPS:
        free_before = visible[:, :-LOOKBACK_STEPS] & ~_widened(occupied[:, :-LOOKBACK_STEPS], 1)
        entered[:, LOOKBACK_STEPS:] = occupied[:, LOOKBACK_STEPS:] & free_before
    return entered & ~standing


def _standing(windows: Tensor) -> Tensor:
    """The cells (B, 1, M, M) bool of standing objects, and the cells around them."""
    seen, filled = windows.view(torch.uint8).sum(dim=1, dtype=torch.int32).unbind(dim=1)
    return _widened((filled > STANDING_SHARE * seen)[:, None], 1)


def _widened(cells: Tensor, by: int) -> Tensor:
    """`cells` (B, T, M, M) bool, and all at most `by` rows and columns away."""
    for axis in (-2, -1):
        wide, size = cells.clone(), cells.shape[axis]
        for shift in range(1, min(by, size - 1) + 1):
            wide.narrow(axis, shift, size - shift).logical_or_(cells.narrow(axis, 0, size - shift))
            wide.narrow(axis, 0, size - shift).logical_or_(cells.narrow(axis, shift, size - shift))
        cells = wide
    return cells
