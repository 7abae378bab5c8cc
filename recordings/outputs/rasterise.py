"""P(occupied) of objects: the cells that their outlines pass through at each time ahead, blurred by the position.

A laser sees surfaces, so the inside of an object is not occupied. Objects and the static map are independent causes.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec, rolled, shift_between, snapped
from gridtrack.common.raycast import cross
from gridtrack.recordings.outputs.object_table import Numbers, PredictedPath, RecordedObject

KERNEL_SIGMAS = 3.0
"""Half the width of the blur."""
SHARPEST_CELLS = 0.1
"""Least standard deviation of the blur, in cells: one that moves nothing to a neighbour."""
STATIC_SHARE = 0.5
"""A cell is static if it was occupied in more than this share of the frames in which it was visible."""


class StaticMap:
    """Cells that were mostly occupied in the frames so far, in a window that scrolls with the sensor."""

    def __init__(self, grid: GridSpec) -> None:
        self._counts = np.zeros((2, *grid.shape), np.int32)
        self._cell_m = grid.cell_m
        self._window: SE2 | None = None

    def add(self, frame: GridFrame) -> None:
        """Count the visible and the occupied cells of the next frame."""
        if self._window is not None and frame.world_T_grid != self._window:
            shift = shift_between(self._window, frame.world_T_grid, self._cell_m)
            self._counts = rolled(self._counts, shift, 0)
        self._window = frame.world_T_grid
        self._counts += np.stack([frame.visible, frame.occupied])

    @property
    def probability(self) -> NDArray[np.float32]:
        """P(occupied) (M, M): the share of the frames in which a static cell was occupied, 0 for other cells."""
        visible, occupied = self._counts
        share = occupied / np.maximum(visible, 1)
        return np.where(share > STATIC_SHARE, share, 0.0).astype(np.float32)


def draw_object(
    planes: NDArray[np.float32],
    one: RecordedObject,
    velocity: Numbers,
    lead_s: Numbers,
    grid: GridSpec,
    world_T_grid: SE2,
    width_m: float,
) -> None:
    """Add an object to `planes` (T, M, M), P(occupied) at `lead_s` (T,) in a window that is not turned.

    Without predicted paths it moves at `velocity` (2,). Without a covariance its position has the standard deviation
    `width_m`.
    """
    after = one.pose + np.array([*velocity, 0.0])
    paths = one.paths or (PredictedPath(1.0, np.array([0.0, 1.0]), np.array([one.pose, after])),)
    poses = np.stack([poses_at(path, lead_s) for path in paths])
    covariance = np.eye(2) * width_m**2 if one.covariance is None else one.covariance
    kernel = blur(covariance / grid.cell_m**2, grid.size)
    if kernel is None:
        return
    c, s = np.cos(poses[..., 2, None]), np.sin(poses[..., 2, None])
    x, y = one.outline.T
    corners = np.stack([poses[..., 0, None] + c * x - s * y, poses[..., 1, None] + s * x + c * y], axis=-1)
    corners = snapped((corners - [world_T_grid.x, world_T_grid.y] - grid.origin) / grid.cell_m)
    if np.abs(corners).max() < 1e8:
        _draw(planes, corners, np.array([path.probability for path in paths]), kernel, one.existence)


def poses_at(path: PredictedPath, lead_s: Numbers) -> Numbers:
    """The poses (T, 3) of a path at `lead_s` (T,); after its end it goes on as between its last two poses."""
    poses = path.poses.copy()
    poses[:, 2] = np.unwrap(poses[:, 2])
    at = np.clip(np.searchsorted(path.lead_s, lead_s, side="right") - 1, 0, len(poses) - 2)
    share = ((lead_s - path.lead_s[at]) / (path.lead_s[at + 1] - path.lead_s[at]))[:, None]
    found: Numbers = poses[at] + share * (poses[at + 1] - poses[at])
    turning = np.minimum(share[:, 0], 1.0)
    found[:, 2] = poses[at, 2] + turning * (poses[at + 1, 2] - poses[at, 2])
    return found


def blur(covariance: Numbers, size: int) -> NDArray[np.float32] | None:
    """The Gaussian with `covariance` (2, 2), in cells, as weights (K, K) by [row, column] that sum to 1.

    None if a standard deviation is greater than `size` cells: the object may be anywhere.
    """
    variances, axes = np.linalg.eigh(covariance)
    variances = np.maximum(variances, SHARPEST_CELLS**2)
    if variances[-1] > size**2:
        return None
    reach = math.ceil(KERNEL_SIGMAS * math.sqrt(variances[-1]))
    offsets = np.stack(np.meshgrid(np.arange(-reach, reach + 1), np.arange(-reach, reach + 1)), axis=-1) @ axes
    weights = np.exp(-0.5 * (offsets**2 / variances).sum(axis=-1))
    scaled: NDArray[np.float32] = (weights / weights.sum()).astype(np.float32)
    return scaled


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _draw(planes, corners, weights, kernel, existence):  # type: ignore[no-untyped-def]
    """Combine outlines (R, T, N, 2), in cells, of R paths into `planes` (T, M, M) by noisy-or.

    The window has a margin, from which the blur reaches into it.
    """
    size, reach = planes.shape[1], kernel.shape[0] // 2
    wide = size + 2 * reach
    crossed = np.zeros(wide * wide, np.bool_)
    shown = np.zeros((size, size), np.float32)
    for t in range(planes.shape[0]):
        shown[:] = 0.0
        for r in range(corners.shape[0]):
            outline = corners[r, t] + reach
            last = outline.shape[0] - 1
            for i in range(outline.shape[0]):
                x0, y0 = outline[last, 0], outline[last, 1]
                cross(x0, y0, outline[i, 0] - x0, outline[i, 1] - y0, wide, crossed)
                last = i
            # one more cell on each side: rounding may move an edge on a border into the next cell
            low = max(math.floor(outline[:, 1].min()) - 1, 0), max(math.floor(outline[:, 0].min()) - 1, 0)
            high = min(math.floor(outline[:, 1].max()) + 2, wide), min(math.floor(outline[:, 0].max()) + 2, wide)
            for row in range(low[0], high[0]):
                for column in range(low[1], high[1]):
                    if crossed[row * wide + column]:
                        crossed[row * wide + column] = False
                        _add(shown, row - 2 * reach, column - 2 * reach, kernel, weights[r])
        for row in range(size):
            for column in range(size):
                cause = np.float32(existence) * min(shown[row, column], np.float32(1.0))
                planes[t, row, column] += (np.float32(1.0) - planes[t, row, column]) * cause


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _add(shown, first_row, first_column, kernel, weight):  # type: ignore[no-untyped-def]
    """Add `kernel` times `weight` to `shown` (M, M), its first weight at a cell that may be outside."""
    for row in range(max(first_row, 0), min(first_row + kernel.shape[0], shown.shape[0])):
        for column in range(max(first_column, 0), min(first_column + kernel.shape[1], shown.shape[1])):
            shown[row, column] += weight * kernel[row - first_row, column - first_column]
