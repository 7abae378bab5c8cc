"""Kinds of cells that the frames of a recording without truth show."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec, Mask, window_about, with_neighbours
from gridtrack.evaluation.scoring.strata import cell_kinds_around
from gridtrack.evaluation.scoring.world_cells import TILE_CELLS, CellPlace, WorldCells, corner_of
from gridtrack.evaluation.scoring.world_kinds import KindsOfPlaces, KindsOfWindow
from gridtrack.recordings.observation import Observation

MIN_HITS = 0.1
"""Where the sensor moves: share of the frames in which a static cell is itself occupied, of those that show it."""
BLOCK_NS = 30_000_000_000
"""Where the sensor moves: a block of time; the cells of a block are judged by it and the blocks before and after."""
StaticTiles = dict[CellPlace, NDArray[np.uint8]]
"""The static cells of a time, a bit each: (TILE_CELLS * TILE_CELLS / 8,) by the place of the tile."""


class KindsOfTimes:
    """Kinds of the cells of the world, other ones in each block of time."""

    def __init__(self, static: Mapping[int, StaticTiles], grid: GridSpec) -> None:
        """`static`: the static cells by block, a stamp divided by BLOCK_NS."""
        self.static, self._grid = static, grid
        self._newest: tuple[int, KindsOfPlaces] | None = None

    def at(self, reference_T_grid: SE2, stamp_ns: int) -> NDArray[np.uint8]:
        """Kind of each cell (M, M). Raises KeyError for a block without a frame."""
        block = stamp_ns // BLOCK_NS
        if self._newest is None or self._newest[0] != block:
            self._newest = block, KindsOfPlaces(_unpacked(self.static[block]), self._grid)
        return self._newest[1].at(reference_T_grid, stamp_ns)


def observed_kinds(observations: Iterable[Observation], grid: GridSpec) -> KindsOfWindow | KindsOfTimes:
    """The kinds that the observations of a recording show, in the order of their stamps.

    Of a sensor at rest a cell is static where it is occupied in more than half of the frames in which it is visible.
    Where the sensor moves, an error of its pose puts a wall into another cell from frame to frame: a cell is static
    where it or a neighbour is occupied in more than half of the frames that show it, and the cell itself in more than
    MIN_HITS of them. Over minutes the errors grow to several cells, so that only frames of the same block of time and
    of those beside it count. The ring is the eight neighbours of a static cell, where range noise flickers; all others
    are dynamic. Raises RecordingError where the windows cover too much.
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
        self._block = 0
        self._counts = np.zeros((3, *grid.shape), np.int64)
        """Of the newest window in the newest block."""
        self._at_rest: NDArray[np.int64] | None = np.zeros_like(self._counts)
        """Of the only window so far, without those in `_counts`; None once it has moved."""
        self._open: dict[int, WorldCells] = {}
        """Of the two newest blocks, and of the one before them."""
        self._judged: dict[int, StaticTiles] = {}

    def add(self, observation: Observation) -> None:
        """Count the next frame, in a window with the axes of the reference world."""
        window = window_about(observation.reference_T_grid, self._grid.cell_m)
        frame = observation.seen_in(window, self._grid).frame
        block = frame.stamp_ns // BLOCK_NS
        if window != self._window or block != self._block:
            self._flush()
            self._judge(block)
            if self._window not in (None, window):
                self._at_rest = None
            self._window, self._block = window, block
        self._counts[0] += frame.visible
        self._counts[1] += frame.occupied
        self._counts[2] += frame.visible & with_neighbours(frame.occupied)

    def kinds(self) -> KindsOfWindow | KindsOfTimes:
        """The kinds, by the rule for a sensor at rest where there was only one window."""
        if self._at_rest is not None:
            seen, hits, _ = self._at_rest + self._counts
            return KindsOfWindow(cell_kinds_around(2 * hits > seen))
        self._flush()
        still_open = {block: self._static(block) for block in self._open if block not in self._judged}
        return KindsOfTimes(self._judged | still_open, self._grid)

    def _flush(self) -> None:
        """Add the counts of the window to those of its block: the window moves now, or another block begins."""
        if self._window is None:
            return
        if self._at_rest is not None:
            self._at_rest += self._counts
        cells = self._open.setdefault(self._block, WorldCells(3, np.int32))
        cells.add(corner_of(self._window, self._grid.cell_m), self._counts)
        self._counts[:] = 0

    def _judge(self, newest: int) -> None:
        """Judge each block whose neighbours are over when `newest` begins, and drop what no other block needs."""
        for block in sorted(self._open):
            if block + 1 < newest and block not in self._judged:
                self._judged[block] = self._static(block)
        self._open = {block: cells for block, cells in self._open.items() if block + 2 >= newest}

    def _static(self, block: int) -> StaticTiles:
        """The static cells of a block, by the counts of it and of the blocks beside it."""
        near = [self._open[one].tiles for one in (block - 1, block, block + 1) if one in self._open]
        static: StaticTiles = {}
        for place in dict.fromkeys(place for tiles in near for place in tiles):
            cells = _is_static(*np.sum([tiles[place] for tiles in near if place in tiles], axis=0))
            if cells.any():
                static[place] = np.packbits(cells)
        return static


def _is_static(seen: NDArray[np.int32], hits: NDArray[np.int32], near: NDArray[np.int32]) -> Mask:
    return (2 * near > seen) & (hits > MIN_HITS * seen)


def _unpacked(static: StaticTiles) -> WorldCells:
    cells = WorldCells(1, np.bool_)
    shape = (1, TILE_CELLS, TILE_CELLS)
    cells.tiles = {place: np.unpackbits(tile).view(np.bool_).reshape(shape) for place, tile in static.items()}
    return cells
