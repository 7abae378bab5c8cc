"""Windows full of moving shapes: what a general network learns motion from before it sees recordings.

In most windows of a recording hardly anything moves, and a network that holds every cell where it is has nearly the
least loss: from recordings alone it leaves that state after thousands of updates, from dense motion after hundreds.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridtrack.trackers.recurrent.sight import cells_in_sight

MOST, FEWEST = 40, 13
"""Number of shapes."""
RADII = (0.6, 3.0)
"""Of discs, and of the short side of rectangles, cells; log-uniform."""
SPEEDS = (0.15, 2.0)
"""Cells a step, log-uniform: a walk in cells of 0.1 to 0.2 m and steps of a tenth of a second."""
STANDING_SHAPES, HIDING_SHAPES, RECTANGLES, LOST_SHARE = 0.25, 0.2, 0.3, 0.1
"""Shares of the shapes that stand, that hide what is behind them and that are rectangles, and of the points that the
laser does not see."""
LASER_RANGES = (0.7, 2.5)
"""Of a laser, in sides of the window."""
TURN = 0.01
"""Standard deviation of the turn in a step, rad."""
SPACING = 0.5
"""Distance of the points on an outline, cells."""


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

    One laser sees them, at a random place and as far as its range: not the sides that face away from it, and a share of
    the points is lost. Some of the shapes hide what is behind them; if all did, hardly anything would be seen to move.
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
    """The occupied cells (steps, size, size) of one shape that nothing hides, seen from the `laser` (2, 1, 1)."""
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
    """Straight on but for a slight turn; in the middle of the time at a random place of the window."""
    speed = 0.0 if draw.random() < STANDING_SHAPES else _log_uniform(draw, SPEEDS)
    heading = draw.uniform(0.0, 2.0 * np.pi) + draw.normal(0.0, TURN) * np.arange(steps, dtype=np.float64)
    way = np.cumsum(speed * np.stack([np.cos(heading), np.sin(heading)]), axis=1)
    return Path(draw.uniform(0.0, size, (2, 1)) + way - way[:, [steps // 2]], heading)


def _log_uniform(draw: np.random.Generator, bounds: tuple[float, float]) -> float:
    return float(np.exp(draw.uniform(*np.log(bounds))))
