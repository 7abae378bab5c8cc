"""The true bodies of a simulated frame: the cells that each occupies, and its motion."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2, wrap_angle
from gridtrack.common.grid import GridSpec
from gridtrack.common.scene import Scene, SceneObject

Points = NDArray[np.floating[Any]]
MOVING_MPS = 0.3
"""Slower bodies count as standing, m/s."""


def bodies(scene: Scene | None) -> dict[int, SceneObject]:
    """The bodies of a scene by their track number. Raises ValueError for a recording without a true scene."""
    if scene is None:
        raise ValueError("the recording has no true scene: choose a simulated one")
    return {body.track: body for body in scene.objects}


def points_within(points: Points, pose: SE2, sides: Sequence[float], margin: float) -> NDArray[np.bool_]:
    """Which `points` (N, 2) lie in the box (x_min, x_max, y_min, y_max) about `pose`, enlarged by `margin`."""
    x_min, x_max, y_min, y_max = sides
    x, y = pose.inverse().apply(points.astype(np.float64)).T
    return np.asarray((x > x_min - margin) & (x < x_max + margin) & (y > y_min - margin) & (y < y_max + margin))


def body_cells(
    body: SceneObject, world_T_grid: SE2, centres: Points, occupied: NDArray[np.bool_], grid: GridSpec
) -> NDArray[np.int64]:
    """The occupied cells (N,), row * M + column, in the bounding box of a body's outline and half a cell around it."""
    (x_min, y_min), (x_max, y_max) = body.outline.min(axis=0), body.outline.max(axis=0)
    pose = world_T_grid.inverse() @ body.world_T_object
    return np.flatnonzero(points_within(centres, pose, (x_min, x_max, y_min, y_max), grid.cell_m / 2) & occupied)


def rigid_velocity(before: SE2, after: SE2, elapsed_s: float, world_T_grid: SE2, points: Points) -> Points:
    """Velocity (2, N), m/s, grid frame, of `points` (N, 2) on a body that moves between two poses in the world."""
    grid_T_before, grid_T_after = (world_T_grid.inverse() @ pose for pose in (before, after))
    turn = wrap_angle(grid_T_after.theta - grid_T_before.theta) / elapsed_s
    middle = np.array([grid_T_before.x + grid_T_after.x, grid_T_before.y + grid_T_after.y]) / 2
    straight = np.array([grid_T_after.x - grid_T_before.x, grid_T_after.y - grid_T_before.y]) / elapsed_s
    x, y = (points - middle).T
    return np.stack([straight[0] - turn * y, straight[1] + turn * x])


def most_frequent(numbers: NDArray[np.int64]) -> int:
    """The most frequent number except -1; -1 if there is no other."""
    known = numbers[numbers >= 0]
    return int(np.bincount(known).argmax()) if known.size else -1
