"""Values of cells of the world, in tiles: memory follows the area that windows covered, and is bounded."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from gridtrack.common.errors import RecordingError
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec

TILE_CELLS = 128
"""Cells along a side of a tile."""
MAX_TILES = 2048
"""Limit of the tiles: an area of 576 x 576 m in cells of 0.1 m, or a way of 26 km in a window of 10 m."""
CellPlace = tuple[int, int]
"""Row and column of a cell, or of a tile, in the world."""


class WorldCells:
    """Layers of values of all cells of the world; 0 where nothing was added."""

    def __init__(self, layers: int, dtype: DTypeLike) -> None:
        self.tiles: dict[CellPlace, NDArray[Any]] = {}
        """(layers, TILE_CELLS, TILE_CELLS) by the row and column of the tile."""
        self._layers, self._dtype = layers, np.dtype(dtype)

    def add(self, corner: CellPlace, values: NDArray[Any]) -> None:
        """Add `values` (layers, R, C) to the cells from `corner` on. Raises RecordingError beyond MAX_TILES."""
        for tile, inside, part in _parts(corner, values.shape[1:]):
            if tile not in self.tiles:
                if len(self.tiles) == MAX_TILES:
                    raise RecordingError(
                        f"the windows cover more than {MAX_TILES * TILE_CELLS**2} cells of the world: name a larger"
                        " cell with --grid, or import a part of the recording"
                    )
                self.tiles[tile] = np.zeros((self._layers, TILE_CELLS, TILE_CELLS), self._dtype)
            self.tiles[tile][:, *inside] += values[:, *part]

    def read(self, corner: CellPlace, shape: tuple[int, int]) -> NDArray[Any]:
        """The values (layers, R, C) of the cells from `corner` on."""
        values = np.zeros((self._layers, *shape), self._dtype)
        for tile, inside, part in _parts(corner, shape):
            if tile in self.tiles:
                values[:, *part] = self.tiles[tile][:, *inside]
        return values


def _parts(
    corner: CellPlace, shape: tuple[int, ...]
) -> Iterator[tuple[CellPlace, tuple[slice, ...], tuple[slice, ...]]]:
    """For each tile of a rectangle of cells: its place, the cells in the tile, and the same ones in the rectangle."""
    along_axis = [list(_along(first, size)) for first, size in zip(corner, shape, strict=True)]
    for row, rows, of_rows in along_axis[0]:
        for column, columns, of_columns in along_axis[1]:
            yield (row, column), (rows, columns), (of_rows, of_columns)


def _along(first: int, size: int) -> Iterator[tuple[int, slice, slice]]:
    for tile in range(first // TILE_CELLS, (first + size - 1) // TILE_CELLS + 1):
        start, stop = max(first, tile * TILE_CELLS), min(first + size, (tile + 1) * TILE_CELLS)
        yield tile, slice(start - tile * TILE_CELLS, stop - tile * TILE_CELLS), slice(start - first, stop - first)


def corner_of(world_T_grid: SE2, cell_m: float) -> CellPlace:
    """Where the window at `world_T_grid`, a whole multiple of the cell, lies in the world."""
    return round(world_T_grid.y / cell_m), round(world_T_grid.x / cell_m)


def cells_in(world_T_grid: SE2, grid: GridSpec) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Row and column in the world (M, M) of the cells in which the centres of a window's cells lie.

    The window may be turned, and lie between the cells of the world.
    """
    centres = grid.cell_centres(np.ones(grid.shape, np.bool_))
    scaled = np.floor((world_T_grid.apply(centres) - grid.origin) / grid.cell_m).astype(np.int64)
    return scaled[:, 1].reshape(grid.shape), scaled[:, 0].reshape(grid.shape)
