"""Kinds of the cells of any window: of a sensor at rest, of places of the world, or from static outlines."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec, window_about
from gridtrack.common.scene import Scene
from gridtrack.evaluation.scoring.strata import cell_kinds_around
from gridtrack.evaluation.scoring.world_cells import WorldCells, cells_in, corner_of
from gridtrack.recordings.truth import static_cells


class CellKinds(Protocol):
    """The kinds of the cells of a stretch."""

    def at(self, reference_T_grid: SE2, stamp_ns: int) -> NDArray[np.uint8]:
        """Kind of each cell (M, M) of the window at `reference_T_grid`, for the frame with this stamp."""
        ...


class KindsOfWindow:
    """Kinds in the one window of a sensor at rest."""

    def __init__(self, cell_kinds: NDArray[np.uint8]) -> None:
        self.cell_kinds = cell_kinds

    def at(self, reference_T_grid: SE2, stamp_ns: int) -> NDArray[np.uint8]:
        """Kind of each cell (M, M)."""
        return self.cell_kinds


class KindsOfOutlines:
    """Kinds from the static outlines of the true scene."""

    def __init__(self, scene: Scene, grid: GridSpec) -> None:
        self._scene, self._grid = scene, grid

    def at(self, reference_T_grid: SE2, stamp_ns: int) -> NDArray[np.uint8]:
        """Kind of each cell (M, M). Raises RecordingError for an outline that cannot be placed."""
        return cell_kinds_around(static_cells(self._scene, self._grid, reference_T_grid))


class KindsOfPlaces:
    """Kinds of the cells of the world; a cell that was in no window is dynamic."""

    def __init__(self, static: WorldCells, grid: GridSpec) -> None:
        """`static` has one layer: whether a cell is static."""
        self.static, self._grid = static, grid

    def at(self, reference_T_grid: SE2, stamp_ns: int) -> NDArray[np.uint8]:
        """Kind of each cell (M, M)."""
        rows, columns = cells_in(reference_T_grid, self._grid)
        first = int(rows.min()) - 1, int(columns.min()) - 1
        shape = int(rows.max()) + 2 - first[0], int(columns.max()) + 2 - first[1]
        kinds = cell_kinds_around(self.static.read(first, shape)[0])
        return kinds[rows - first[0], columns - first[1]]


def kinds_of_outlines(scene: Scene, windows: Iterable[SE2], grid: GridSpec) -> KindsOfWindow | KindsOfPlaces:
    """Kinds from the static outlines of the true scene, of the cells of these windows. Raises RecordingError."""
    known = dict.fromkeys(windows)
    if len(known) == 1:
        (window,) = known
        return KindsOfWindow(cell_kinds_around(static_cells(scene, grid, window)))
    static = WorldCells(1, np.bool_)
    for window in dict.fromkeys(window_about(one, grid.cell_m) for one in known):
        static.add(corner_of(window, grid.cell_m), static_cells(scene, grid, window)[None])
    return KindsOfPlaces(static, grid)
