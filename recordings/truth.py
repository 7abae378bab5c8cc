"""Rasterised ground truth: the cells on the outlines of a scene, and the cells inside them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.common.errors import RecordingError
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec, Mask, snapped
from gridtrack.common.raycast import MAX_COORDINATE_CELLS, cross
from gridtrack.common.scene import PlacedOutlines, Scene

FREE, OUTLINE, INTERIOR = 0, 1, 2
"""True state of a cell: free, on a surface that a laser could hit, or inside an object."""


@dataclass(frozen=True, slots=True)
class TruthGrid:
    """The true state and class of every cell.

    `cover` (M, M) uint8: FREE, OUTLINE or INTERIOR. `labels` (M, M) uint8: the class of each outline cell, UNLABELLED
    elsewhere. `bodies` (M, M) int32: the index of the object of each outline cell, -1 elsewhere.
    """

    cover: NDArray[np.uint8]
    labels: NDArray[np.uint8]
    bodies: NDArray[np.int32]


def truth_grid(scene: Scene, grid: GridSpec, world_T_grid: SE2) -> TruthGrid:
    """The true state of each cell of a grid at the pose `world_T_grid`. Raises RecordingError.

    A cell is OUTLINE if an outline passes through it (touching a corner or edge is not enough), even inside another
    outline. Of several outlines in a cell the last object of the scene counts, and objects before static outlines.
    INTERIOR cells are wholly inside an outline, and on none.
    """
    cover, outline = _drawn(grid, world_T_grid, scene.outlines)
    return TruthGrid(cover, scene.labels[outline], np.maximum(outline - len(scene.static), -1))


def static_cells(scene: Scene, grid: GridSpec, world_T_grid: SE2) -> Mask:
    """Cells (M, M) on a static outline. Raises RecordingError."""
    cover, _ = _drawn(grid, world_T_grid, scene.static_outlines)
    cells: Mask = cover == OUTLINE
    return cells


def _drawn(grid: GridSpec, world_T_grid: SE2, outlines: PlacedOutlines) -> tuple[NDArray[np.uint8], NDArray[np.int32]]:
    """The cover (M, M) of `outlines`, and the index (M, M) of the outline on each cell, -1 for none."""
    cover, outline = np.full(grid.shape, FREE, np.uint8), np.full(grid.shape, -1, np.int32)
    corners = corners_in_cells(outlines, grid, world_T_grid)
    _fill(corners, outlines.starts, cover)
    _trace(corners, outlines.starts, cover, outline, np.zeros(grid.size**2, np.bool_))
    return cover, outline


def corners_in_cells(outlines: PlacedOutlines, grid: GridSpec, world_T_grid: SE2) -> NDArray[np.float64]:
    """The corners (N, 2) of all outlines, (x, y) in cells of the grid. Raises RecordingError."""
    with np.errstate(invalid="ignore"):  # non-finite corners raise an error below
        corners: NDArray[np.float64] = snapped(
            (world_T_grid.inverse().apply(outlines.corners) - grid.origin) / grid.cell_m
        )
    if not (np.abs(corners) < MAX_COORDINATE_CELLS).all():
        raise RecordingError("an outline of the true scene has corners that are not finite: the recording is damaged")
    return corners


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _fill(corners, starts, cover):  # type: ignore[no-untyped-def]
    """Mark the cells with their centre inside an outline (even-odd rule) as INTERIOR, row by row.

    Correct for cells that are on no outline; `_trace` marks the others afterwards.
    """
    size = cover.shape[0]
    crossings = np.empty(corners.shape[0])
    for polygon in range(starts.size - 1):
        first, last = starts[polygon], starts[polygon + 1]
        if last == first:
            continue
        lowest, highest = corners[first:last, 1].min(), corners[first:last, 1].max()
        for row in range(max(math.floor(lowest), 0), min(math.floor(highest) + 1, size)):
            y = row + 0.5
            count = 0
            x0, y0 = corners[last - 1, 0], corners[last - 1, 1]
            for i in range(first, last):
                x1, y1 = corners[i, 0], corners[i, 1]
                if (y0 <= y) != (y1 <= y):
                    crossings[count] = x0 + (y - y0) / (y1 - y0) * (x1 - x0)
                    count += 1
                x0, y0 = x1, y1
            inside = np.sort(crossings[:count])
            for k in range(0, count - 1, 2):
                for column in range(max(math.ceil(inside[k] - 0.5), 0), min(math.ceil(inside[k + 1] - 0.5), size)):
                    cover[row, column] = INTERIOR


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _trace(corners, starts, cover, outline, crossed):  # type: ignore[no-untyped-def]
    """Mark the cells on outlines as OUTLINE, with the index of the outline; later outlines replace earlier ones."""
    size = cover.shape[0]
    for polygon in range(starts.size - 1):
        first, last = starts[polygon], starts[polygon + 1]
        if last == first:
            continue
        x0, y0 = corners[last - 1, 0], corners[last - 1, 1]
        left = right = x0
        bottom = top = y0
        for i in range(first, last):
            x1, y1 = corners[i, 0], corners[i, 1]
            cross(x0, y0, x1 - x0, y1 - y0, size, crossed)
            left, right, bottom, top = min(left, x1), max(right, x1), min(bottom, y1), max(top, y1)
            x0, y0 = x1, y1
        # one more cell on each side: rounding may move an edge on a border into the next cell
        for row in range(max(math.floor(bottom) - 1, 0), min(math.floor(top) + 2, size)):
            for column in range(max(math.floor(left) - 1, 0), min(math.floor(right) + 2, size)):
                if crossed[row * size + column]:
                    crossed[row * size + column] = False
                    cover[row, column] = OUTLINE
                    outline[row, column] = polygon
