"""Kinds of cells in any window: from static outlines, or from what all frames of a recording show at each place."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec, Mask, window_about, with_neighbours
from gridtrack.common.scene import Scene
from gridtrack.evaluation.scoring.strata import cell_kinds_around
from gridtrack.evaluation.scoring.world_cells import WorldCells, cells_in, corner_of
from gridtrack.recordings.observation import Observation
from gridtrack.recordings.truth import static_cells

MIN_HITS = 0.1
"""Where the sensor moves: share of the frames in which a static cell is itself occupied, of those that show it."""


class CellKinds(Protocol):
    """The kinds of the cells of a stretch."""

    def at(self, reference_T_grid: SE2) -> NDArray[np.uint8]:
        """Kind of each cell (M, M) of the window at `reference_T_grid`."""
        ...


class KindsOfWindow:
    """Kinds in the one window of a sensor at rest."""

    def __init__(self, cell_kinds: NDArray[np.uint8]) -> None:
        self.cell_kinds = cell_kinds

    def at(self, reference_T_grid: SE2) -> NDArray[np.uint8]:
        """Kind of each cell (M, M)."""
        return self.cell_kinds


class KindsOfOutlines:
    """Kinds from the static outlines of the true scene."""

    def __init__(self, scene: Scene, grid: GridSpec) -> None:
        self._scene, self._grid = scene, grid

    def at(self, reference_T_grid: SE2) -> NDArray[np.uint8]:
        """Kind of each cell (M, M). Raises RecordingError for an outline that cannot be placed."""
        return cell_kinds_around(static_cells(self._scene, self._grid, reference_T_grid))


class KindsOfPlaces:
    """Kinds of the cells of the world; a cell that was in no window is dynamic."""

    def __init__(self, static: WorldCells, grid: GridSpec) -> None:
        """`static` has one layer: whether a cell is static."""
        self.static, self._grid = static, grid

    def at(self, reference_T_grid: SE2) -> NDArray[np.uint8]:
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
        return KindsOfWindow(KindsOfOutlines(scene, grid).at(*known))
    static = WorldCells(1, np.bool_)
    for window in dict.fromkeys(window_about(one, grid.cell_m) for one in known):
        static.add(corner_of(window, grid.cell_m), static_cells(scene, grid, window)[None])
    return KindsOfPlaces(static, grid)


def observed_kinds(observations: Iterable[Observation], grid: GridSpec) -> KindsOfWindow | KindsOfPlaces:
    """The kinds that the observations of a recording show.

    Of a sensor at rest a cell is static where it is occupied in more than half of the frames in which it is visible.
    Where the sensor moves, an error of its pose puts a wall into another cell from frame to frame: a cell is static
    where it or a neighbour is occupied in more than half of the frames that show it, and the cell itself in more than
    MIN_HITS of them. The ring is the eight neighbours of a static cell, where range noise flickers; all others are
    dynamic. Raises RecordingError where the windows cover too much.
    """
    counts = ObservedCounts(grid)
    for observation in observations:
        counts.add(observation)
    return counts.kinds()


class ObservedCounts:
    """In how many frames each cell is visible, occupied, and visible beside an occupied cell or occupied."""

    def __init__(self, grid: GridSpec) -> None:
        self._grid = grid
        self._window: SE2 | None = None
        self._counts = np.zeros((3, *grid.shape), np.int64)
        self._world: WorldCells | None = None

    def add(self, observation: Observation) -> None:
        """Count the next frame, in a window with the axes of the reference world."""
        window = window_about(observation.reference_T_grid, self._grid.cell_m)
        frame = observation.seen_in(window, self._grid).frame
        if window != self._window:
            self._flush()
            self._window = window
        self._counts[0] += frame.visible
        self._counts[1] += frame.occupied
        self._counts[2] += frame.visible & with_neighbours(frame.occupied)

    def _flush(self) -> None:
        """Add the counts of the window, which moves now, to those of the world."""
        if self._window is not None:
            self._world = self._world or WorldCells(3, np.int32)
            self._world.add(corner_of(self._window, self._grid.cell_m), self._counts)
            self._counts[:] = 0

    def kinds(self) -> KindsOfWindow | KindsOfPlaces:
        """The kinds, by the rule for a sensor at rest where there was only one window."""
        if self._world is None:
            seen, hits, _ = self._counts
            return KindsOfWindow(cell_kinds_around(2 * hits > seen))
        self._flush()
        static = WorldCells(1, np.bool_)
        static.tiles = {place: _static(*counts)[None] for place, counts in self._world.tiles.items()}
        return KindsOfPlaces(static, self._grid)


def _static(seen: NDArray[np.int32], hits: NDArray[np.int32], near: NDArray[np.int32]) -> Mask:
    return (2 * near > seen) & (hits > MIN_HITS * seen)
