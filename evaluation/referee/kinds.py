"""Regions of a stretch: the kinds of its cells in the world give region maps of the window of any frame."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import DTypeLike, NDArray

from gridtrack.common.errors import RecordingError
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec, Mask, window_about, with_neighbours
from gridtrack.common.scene import Scene
from gridtrack.evaluation.referee.strata import STRATA, RegionMaps, cell_kinds_around, region_maps_of
from gridtrack.recordings.observation import Observation
from gridtrack.recordings.stream import GridStream
from gridtrack.recordings.truth import static_cells


class Regions:
    """The regions of a stretch, in the window of any of its frames; `strata` are the names of those scored.

    Bands of range are about the sensors at the frame of the window, at which a forecast is made.
    """

    def __init__(self, grid: GridSpec, kinds: CellKinds, strata: tuple[str, ...] = STRATA) -> None:
        self.strata = strata
        self._grid, self._kinds = grid, kinds
        self._newest: tuple[object, RegionMaps] | None = None

    def of(self, observation: Observation) -> RegionMaps:
        """The region maps of the window of an observation. Raises RecordingError for a scene that cannot be placed."""
        pose, origins, stamp_ns = observation.reference_T_grid, observation.frame.origins, observation.frame.stamp_ns
        key, newest = (pose, origins.tobytes(), stamp_ns // BLOCK_NS), self._newest
        if newest is not None and newest[0] == key:
            return newest[1]
        maps = region_maps_of(self._kinds.at(pose, stamp_ns), self._grid, origins, self.strata)
        self._newest = key, maps
        return maps


def regions_of(stream: GridStream, strata: tuple[str, ...], check: Callable[[], None] = lambda: None) -> Regions:
    """Regions of a stretch: from the true scene, without truth from a pass over the whole recording.

    `check()` is called at each frame of the pass; what it raises ends it. Raises RecordingError.
    """
    scene = next((one.scene for one in stream.observations() if one.scene), None) if stream.has_truth else None
    if scene:
        return Regions(stream.grid, KindsOfOutlines(scene, stream.grid), strata)
    return Regions(stream.grid, observed_kinds(_checked(stream.all_observations(), check), stream.grid), strata)


def _checked(observations: Iterator[Observation], check: Callable[[], None]) -> Iterator[Observation]:
    for observation in observations:
        check()
        yield observation


TILE_CELLS = 128
"""Cells along a side of a tile."""
MAX_TILES = 2048
"""Limit of the tiles: an area of 576 x 576 m in cells of 0.1 m, or a way of 26 km in a window of 10 m."""
CellPlace = tuple[int, int]
"""Row and column of a cell, or of a tile, in the world."""


class WorldCells:
    """Layers of values of all cells of the world; 0 if nothing was added."""

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


MIN_HITS = 0.1
"""For a moving sensor: share of the frames showing a static cell in which the cell itself is occupied."""
BLOCK_NS = 30_000_000_000
"""If the sensor moves: a block of time; the cells of a block are judged by it and the blocks before and after."""
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
    If the sensor moves, an error of its pose puts a wall into another cell from frame to frame: a cell is static
    where it or a neighbour is occupied in more than half of the frames that show it, and the cell itself in more than
    MIN_HITS of them. Over minutes the errors grow to several cells, so that only frames of the same block of time and
    of those beside it count. The ring is the eight neighbours of a static cell, where range noise flickers; all others
    are dynamic. Raises RecordingError if the windows cover too much.
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
        """The kinds, by the rule for a sensor at rest if there was only one window."""
        if self._at_rest is not None:
            seen, hits, _ = self._at_rest + self._counts
            return KindsOfWindow(cell_kinds_around(2 * hits > seen))
        self._flush()
        still_open = {block: self._static(block) for block in self._open if block not in self._judged}
        return KindsOfTimes(self._judged | still_open, self._grid)

    def _flush(self) -> None:
        """Add the counts of the window to its block: the window moves now, or another block begins."""
        if self._window is None:
            return
        if self._at_rest is not None:
            self._at_rest += self._counts
        cells = self._open.setdefault(self._block, WorldCells(3, np.int32))
        cells.add(corner_of(self._window, self._grid.cell_m), self._counts)
        self._counts[:] = 0

    def _judge(self, newest: int) -> None:
        """Judge each block with neighbours that are over when `newest` begins, and drop counts no other block needs."""
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
