"""The tracker `static-map`: the occupied rate of each cell, in the training recordings or in the stream so far."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from gridtrack.common.config import Settings
from gridtrack.common.errors import WeightsError
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec, shift_between
from gridtrack.trackers.baselines.cell_rates import LearnedRates, RunningRates, smoothed_rate
from gridtrack.trackers.card import card_for
from gridtrack.trackers.contract import FitTask, Forecast, StreamSpec, Tracker
from gridtrack.trackers.registry import registered_name
from gridtrack.trackers.site_map import SiteMap
from gridtrack.trackers.weights import Weights, array, load_weights, save_weights

MAX_MAP_SIZE = 4096
"""Limit of the cells a side of a map, which spans the windows of its training frames."""


class StaticMapOptions(Settings):
    """Options of the static map."""

    prior_frames: float = Field(1.0, ge=0.0)
    """Weight of the overall rate as a prior, in frames: it dominates in cells that were rarely visible."""


class StaticMapTracker(Tracker):
    """Forecasts the occupied rate of each cell among its visible training frames, for every step.

    The map lies in the world: a window takes the part of it that it covers, and the overall rate elsewhere. General
    weights have no map: the rate of each cell is then that of the stream so far.
    """

    Options = StaticMapOptions
    moving_sensor = True
    learns = True
    learns_general = True
    role = "floor"

    def __init__(self, stream: StreamSpec, options: StaticMapOptions) -> None:
        super().__init__(stream, options)
        weights = load_weights(stream, registered_name(type(self)))
        occupied, visible = (array(weights, name, _shape_of(weights, stream.grid)) for name in ("occupied", "visible"))
        if not ((occupied >= 0) & (occupied <= visible)).all():
            raise WeightsError(f"{stream.weights}: a cell has more occupied than visible frames: train again")
        if not visible.any():
            raise WeightsError(f"{stream.weights}: no cell was visible: train again")
        self._overall = float(occupied.sum() / visible.sum())
        self.frequency = smoothed_rate(occupied, visible, self._overall, options.prior_frames)
        self._card = weights.card
        self.reset(seed=0)

    def reset(self, seed: int) -> None:
        """A map does not change; counts of the stream begin again."""
        grid = self.stream.grid
        self._rates: LearnedRates | RunningRates
        if self._card.general:
            self._rates = RunningRates(grid, self._overall, self.options.prior_frames)
        else:
            place = SiteMap(self.frequency, self._overall, grid.cell_m, self._card.map_pose, grid.size)
            self._rates = LearnedRates(place)

    def update(self, frame: GridFrame) -> None:
        """Take the part of the map that lies in the window, or count the frame where there is no map."""
        self._rates.observe(frame)

    def predict(self, steps: int) -> Forecast:
        """The rates in the window (steps+1, M, M), the same for every step."""
        return Forecast(np.tile(self._rates.in_window, (steps + 1, 1, 1)))

    @classmethod
    def fit(cls, task: FitTask) -> None:
        """Count the visible and the occupied frames of every cell in `task.train`, wherever the window went.

        Raises WeightsError where the stretches differ in grid, period or site, no cell is visible, or the map is too
        large.
        """
        card = card_for(registered_name(cls), task, task.options.model_dump(mode="json"))
        frames = (frame for source in task.train for frame in source)
        if task.general:
            sums = np.sum([(frame.occupied.sum(), frame.visible.sum()) for frame in frames], axis=0, dtype=np.int64)
            occupied, visible = sums.reshape(2, 1, 1)
        else:
            counts = WorldCounts(task.train[0].grid)
            for frame in frames:
                counts.add(frame)
            occupied, visible, place = counts.occupied, counts.visible, counts.world_T_map
            card = card.model_copy(update={"world_T_grid": place and (place.x, place.y)})
        if not visible.any():
            raise WeightsError(f"no cell is visible in {', '.join(source.name for source in task.train)}")
        save_weights(task.out, card, {"occupied": occupied, "visible": visible})
        task.report(
            f"{card.tracker}: {np.count_nonzero(visible)} cells seen, overall rate {occupied.sum() / visible.sum():.4f}"
        )


class WorldCounts:
    """Frames in which each cell of the world was `visible` and `occupied`, (R, C) int64; R and C are at least M.

    Cell [0, 0] is that of a window at the pose `world_T_map`, which is None before the first frame.
    """

    def __init__(self, grid: GridSpec) -> None:
        self._grid = grid
        self.visible, self.occupied = np.zeros(grid.shape, np.int64), np.zeros(grid.shape, np.int64)
        self.world_T_map: SE2 | None = None

    def add(self, frame: GridFrame) -> None:
        """Count one frame. Raises WeightsError where the map would have more than MAX_MAP_SIZE cells a side."""
        self.world_T_map = self.world_T_map or frame.world_T_grid
        shift = shift_between(self.world_T_map, frame.world_T_grid, self._grid.cell_m)
        first = tuple(self._grown(axis, by) for axis, by in enumerate(shift))
        window = tuple(slice(start, start + self._grid.size) for start in first)
        self.visible[window] += frame.visible
        self.occupied[window] += frame.occupied

    def _grown(self, axis: int, start: int) -> int:
        """Where the cells `start`, ... of a window begin on an axis of the map, which has grown to hold them."""
        size, extent = self._grid.size, self.visible.shape[axis]
        windows_before = -(min(start, 0) // size)
        windows_after = max(-(-(start + size - extent) // size), 0)
        if not windows_before and not windows_after:
            return start
        before, after = windows_before * size, windows_after * size
        if extent + before + after > MAX_MAP_SIZE:
            raise WeightsError(
                f"the window moves over {extent + before + after} cells, and a map has at most"
                f" {MAX_MAP_SIZE} a side: train on a shorter stretch"
            )
        grown = [(before, after) if each == axis else (0, 0) for each in range(2)]
        self.visible, self.occupied = np.pad(self.visible, grown), np.pad(self.occupied, grown)
        assert self.world_T_map is not None
        down_m = before * self._grid.cell_m
        x, y = self.world_T_map.x, self.world_T_map.y
        self.world_T_map = SE2(x, y - down_m) if axis == 0 else SE2(x - down_m, y)
        return start + before


def _shape_of(weights: Weights, grid: GridSpec) -> tuple[int, int]:
    """The shape that the counts must have: a map may be larger than a window of `grid`."""
    occupied = weights.arrays.get("occupied")
    if weights.card.general:
        return 1, 1
    if occupied is None or occupied.ndim != 2:
        return grid.shape
    return max(occupied.shape[0], grid.size), max(occupied.shape[1], grid.size)
