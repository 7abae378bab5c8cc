"""Forecasts of a file as they are read at the frames of a stream: in its window, at its steps.

A forecast counts from the moment when it was available. At each frame the newest one is read, at the times ahead that
are nearest to those of the steps.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.forecast_file import ForecastFile
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec

STALE_S = 1.0
"""An older forecast is not read: the frame has none."""


class ReadForecast(NamedTuple):
    """`occupancy` (S, M, M), NaN in cells without a forecast; `velocity` (S, 2, M, M) and `futures` (F, S, M, M)."""

    occupancy: NDArray[np.float32]
    velocity: NDArray[np.float32] | None = None
    futures: NDArray[np.float16] | None = None


class ForecastReader:
    """The forecasts of a file, in the windows of a stream."""

    def __init__(self, file: ForecastFile, grid: GridSpec, period_s: float) -> None:
        self.file, self._grid, self._period_s = file, grid, period_s
        spacing_s = float(np.median(np.diff(file.stamp_ns))) / 1e9 if len(file) > 1 else period_s
        self._tolerance_ns = round(min(period_s, spacing_s) * 5e8)
        self._cells: dict[SE2, CellMap] = {}

    def newest(self, stamp_ns: int) -> int | None:
        """The number of the newest forecast available at a frame; None if there is none, or it is older than STALE_S.

        The scan of a frame may be half a period later than its stamp, and so may its forecast, but by no more than half
        the time between two forecasts.
        """
        limit = stamp_ns + self._tolerance_ns
        end = int(np.searchsorted(self.file.stamp_ns, limit, "right"))
        for n in range(end - 1, -1, -1):
            if stamp_ns - self.file.stamp_ns[n] > STALE_S * 1e9:
                return None
            if self.file.available_ns[n] <= limit:
                return n
        return None

    def at(self, stamp_ns: int, world_T_grid: SE2, steps: int) -> ReadForecast:
        """The forecast read at a frame, for steps 0..`steps` in its window; NaN in cells without a forecast."""
        shape = self._grid.shape
        occupancy = np.full((steps + 1, *shape), np.nan, np.float32)
        n = self.newest(stamp_ns)
        if n is None:
            return ReadForecast(occupancy)
        leads = self._leads(n, stamp_ns, steps)
        cells = [self._map(n, lead, world_T_grid) for lead in leads]
        for step, (lead, own) in enumerate(zip(leads, cells, strict=True)):
            occupancy[step] = own.largest(self.file.occupancy(n, lead))
        futures = velocity = None
        if self.file.has_futures:
            sampled = [own.largest(self.file.futures(n, lead)) for lead, own in zip(leads, cells, strict=True)]
            futures = np.nan_to_num(np.stack(sampled, axis=1)).astype(np.float16)
        if self.file.has_velocity:
            velocity = np.stack(
                [own.turned(self.file.velocity(n, lead)) for lead, own in zip(leads, cells, strict=True)]
            )
        return ReadForecast(occupancy, velocity, futures)

    def _leads(self, n: int, stamp_ns: int, steps: int) -> list[int]:
        """The index of the time ahead that is nearest to each step, of two equally near ones the earlier."""
        ahead_s = (stamp_ns - int(self.file.stamp_ns[n])) / 1e9 + np.arange(steps + 1) * self._period_s
        distance = np.abs(self.file.lead_s - ahead_s[:, None])
        return [int(own.argmin()) for own in np.round(distance, 6)]

    def _map(self, n: int, lead: int, world_T_grid: SE2) -> CellMap:
        """The cells of a plane in a window; equal poses, as of a sensor at rest, share one."""
        grid_T_file = world_T_grid.inverse() @ self.file.world_T_grid(n, lead)
        if grid_T_file not in self._cells:
            self._cells = {grid_T_file: CellMap(self.file, self._grid, grid_T_file)}
        return self._cells[grid_T_file]


class CellMap:
    """The cells of a file's planes (H, W) in a window (M, M) that lies at `grid_T_file`.

    A cell of the window has the largest value of the cells with their centres in it: the probability that one of them
    is occupied is at least that. Without such a centre, where the cells of the file are larger, it has the value of the
    cell that its own centre lies in. Cells outside the planes have none.
    """

    def __init__(self, file: ForecastFile, grid: GridSpec, grid_T_file: SE2) -> None:
        self._turn, self._shape = grid_T_file.theta, grid.shape
        rows, columns = file.shape
        centres = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2) + 0.5
        cells, inside = grid.cells_of(grid_T_file.apply(centres * file.cell_m))
        to = cells[:, 0] * grid.size + cells[:, 1]
        source = np.flatnonzero(inside)
        self._source = source[np.argsort(to[source], kind="stable")]
        self._to, self._first = np.unique(to[self._source], return_index=True)
        own = grid_T_file.inverse().apply(grid.cell_centres(np.ones(grid.shape, np.bool_)).astype(np.float64))
        column, row = np.floor(own / file.cell_m + 1e-6).astype(np.int64).T
        self._around = np.flatnonzero((row >= 0) & (row < rows) & (column >= 0) & (column < columns))
        self._from = row[self._around] * columns + column[self._around]
        self._lacking = np.isin(self._around, self._to, invert=True)

    def largest(self, planes: NDArray[np.float32]) -> NDArray[np.float32]:
        """The values (..., M, M) of probabilities (..., H, W); NaN: no value."""
        flat = planes.reshape(*planes.shape[:-2], -1)
        found = np.full((*flat.shape[:-1], self._shape[0] * self._shape[1]), np.nan, np.float32)
        if self._to.size:
            found[..., self._to] = np.fmax.reduceat(flat[..., self._source], self._first, axis=-1)
        found[..., self._around[self._lacking]] = flat[..., self._from[self._lacking]]
        return found.reshape(*flat.shape[:-1], *self._shape)

    def turned(self, velocity: NDArray[np.float32]) -> NDArray[np.float32]:
        """The velocities (2, M, M) in the window of velocities (2, H, W): of the cell that each centre lies in."""
        flat, found = velocity.reshape(2, -1), np.full((2, self._shape[0] * self._shape[1]), np.nan, np.float32)
        c, s = np.cos(self._turn), np.sin(self._turn)
        x, y = flat[:, self._from]
        found[:, self._around] = np.stack([c * x - s * y, s * x + c * y])
        return found.reshape(2, *self._shape)
