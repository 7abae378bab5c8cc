"""Flow: the velocity of each cell near the predicted position of a track, at each step."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import GridSpec
from gridtrack.trackers.model_free.arrays import Array
from gridtrack.trackers.model_free.motion.model import propagate
from gridtrack.trackers.model_free.motion.parameters import MotionModel
from gridtrack.trackers.model_free.tracks import Status, Track

FLOW_REACH_SIGMAS = 2.0
"""A cell has the velocity of a track that is nearer than a cell and so many standard deviations of its position."""


def flow_of(tracks: Sequence[Track], steps: int, model: MotionModel, grid: GridSpec) -> NDArray[np.float16]:
    """Velocities (steps+1, 2, M, M), m/s, at steps 0..steps; NaN in cells that no confirmed or coasting track reaches.

    `grid` has its corner in the fixed frame. A cell has the velocity of the track whose bounding box is nearest to its
    centre at that step: of the point of the rigid body there, predicted with the motion `model`.
    """
    kept = [track for track in tracks if track.status is not Status.TENTATIVE]
    flow = np.full((steps + 1, 2, *grid.shape), np.nan, np.float32)
    if kept:
        means, covariances = propagate(
            np.array([track.estimator.mean for track in kept]),
            np.array([track.estimator.covariance for track in kept]),
            steps,
            model,
        )
        boxes = np.array([(*track.shape.offsets.min(axis=0), *track.shape.offsets.max(axis=0)) for track in kept])
        variances = np.trace(covariances[..., :2, :2], axis1=2, axis2=3) / 2.0
        reach_m = grid.cell_m + FLOW_REACH_SIGMAS * np.sqrt(variances)
        draw_flow(flow, boxes, means, reach_m, np.array(grid.origin), grid.cell_m)
    return flow.astype(np.float16)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def draw_flow(flow, boxes, means, reach_m, corner, cell_m):  # type: ignore[no-untyped-def]
    """Draw T bodies with `boxes` (T, 4) in their frames, states `means` (T, n+1, 6), into `flow` (n+1, 2, M, M)."""
    size = flow.shape[2]
    for n in range(flow.shape[0]):
        nearest = np.full((size, size), np.inf)
        for t in range(len(boxes)):
            left, bottom, right, top = boxes[t, 0], boxes[t, 1], boxes[t, 2], boxes[t, 3]
            x, y, heading, vx, vy, turn_rate = means[t, n]
            cos, sin, reach = math.cos(heading), math.sin(heading), reach_m[t, n]
            radius = reach + math.hypot(max(abs(left), abs(right)), max(abs(bottom), abs(top)))
            rows, columns = _covered(y - corner[1], radius, cell_m, size), _covered(x - corner[0], radius, cell_m, size)
            for row in range(rows[0], rows[1]):
                dy = corner[1] + (row + 0.5) * cell_m - y
                for column in range(columns[0], columns[1]):
                    dx = corner[0] + (column + 0.5) * cell_m - x
                    ahead, aside = cos * dx + sin * dy, cos * dy - sin * dx
                    out_x, out_y = max(left - ahead, 0.0, ahead - right), max(bottom - aside, 0.0, aside - top)
                    squared = out_x * out_x + out_y * out_y
                    if squared <= reach * reach and squared < nearest[row, column]:
                        nearest[row, column] = squared
                        flow[n, 0, row, column] = vx - turn_rate * dy
                        flow[n, 1, row, column] = vy + turn_rate * dx


@numba.njit(error_model="numpy")
def _covered(centre_m, radius_m, cell_m, size):  # type: ignore[no-untyped-def]
    """First cell, and the one behind the last, of `size` cells along an axis that are within a radius of a centre."""
    first, last = (centre_m - radius_m) / cell_m, (centre_m + radius_m) / cell_m
    return int(min(max(first, 0.0), size)), int(min(max(last + 1.0, 0.0), size))


def compile_flow() -> None:
    """Compile the kernel, by running it without tracks."""
    none: Array = np.zeros((0, 4))
    draw_flow(np.zeros((1, 2, 1, 1), np.float32), none, np.zeros((0, 1, 6)), np.zeros((0, 1)), np.zeros(2), 1.0)
