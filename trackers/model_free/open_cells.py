"""The cells in which the returns of a training are counted: those in which a return has moved in."""

from __future__ import annotations

from typing import Protocol

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec, Mask, shift_between
from gridtrack.trackers.open_space import OpenSpace
from gridtrack.trackers.site_map import SiteMap


class OpenCells(Protocol):
    """The open cells of a stream, asked for each frame in order."""

    def of(self, frame: GridFrame) -> Mask:
        """The open cells (M, M) of the frame's window."""


class OpenOnMap:
    """The cells that a map of the place has open; those outside the map are open too."""

    def __init__(self, open_cells: SiteMap) -> None:
        self._map = open_cells

    def of(self, frame: GridFrame) -> Mask:
        """The open cells (M, M) of the frame's window."""
        return self._map.at(frame.world_T_grid)


class OpenSoFar:
    """Without a map: the cells that were open in more than `share` of the frames before (`OpenSpace`)."""

    def __init__(self, grid: GridSpec, period_s: float, share: float) -> None:
        self._space, self._share, self._cell_m = OpenSpace(grid.shape, period_s), share, grid.cell_m
        self._window: SE2 | None = None

    def of(self, frame: GridFrame) -> Mask:
        """The open cells (M, M) of the frame's window, as of the frame before."""
        window = self._window or frame.world_T_grid
        if shift := shift_between(window, frame.world_T_grid, self._cell_m):
            self._space.scroll(shift)
        self._window = frame.world_T_grid
        closed = self._space.closed(self._share)
        self._space.observe(frame, 1)
        return ~closed
