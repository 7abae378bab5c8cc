"""The floors of every comparison, which a tracker must beat: `blank`, `persistence`, `static-map`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from gridtrack.common.config import Settings
from gridtrack.common.errors import WeightsError
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec, rolled, shift_between
from gridtrack.trackers.contract import FitTask, Forecast, StreamSpec, Tracker
from gridtrack.trackers.registry import registered_name
from gridtrack.trackers.site_map import SiteMap
from gridtrack.trackers.training.card import card_for
from gridtrack.trackers.training.weights import Weights, array, load_weights, save_weights

MAX_MAP_SIZE = 4096
"""Most cells per side of the map of `static-map`, which covers the windows of all training frames."""


class BlankTracker(Tracker):
    """Forecasts P(occupied) = 0 for every cell and step."""

    moving_sensor = True
    role = "floor"

    def reset(self, seed: int) -> None:
        """The tracker has no state."""

    def update(self, frame: GridFrame) -> None:
        """The tracker has no state."""

    def predict(self, steps: int) -> Forecast:
        """Zero (steps+1, M, M)."""
        return Forecast(np.zeros((steps + 1, *self.stream.grid.shape), np.float32))


class PersistenceTracker(Tracker):
    """Forecasts the last observed state of each cell; 0 where a cell was never visible since it came into the window.

    When the window moves, each cell keeps its place in the world.
    """

    moving_sensor = True
    role = "floor"
    reference_for = frozenset({"occupancy"})

    def __init__(self, stream: StreamSpec, options: Any) -> None:
        super().__init__(stream, options)
        self.reset(seed=0)

    def reset(self, seed: int) -> None:
        """No cell has been observed."""
        self.last_observed = np.zeros(self.stream.grid.shape, np.float32)
        self._world_T_grid: SE2 | None = None

    def update(self, frame: GridFrame) -> None:
        """Store the state of the visible cells."""
        shift = shift_between(self._world_T_grid or frame.world_T_grid, frame.world_T_grid, self.stream.grid.cell_m)
        if shift:
            self.last_observed = rolled(self.last_observed, shift, 0.0)
        self._world_T_grid = frame.world_T_grid
        np.copyto(self.last_observed, frame.occupied, where=frame.visible)

    def predict(self, steps: int) -> Forecast:
        """The last observed state (steps+1, M, M), the same for every step."""
        return Forecast(np.tile(self.last_observed, (steps + 1, 1, 1)))


class StaticMapOptions(Settings):
    """Options of the static map."""

    prior_frames: float = Field(1.0, ge=0.0)
    """Weight of the overall rate as a prior, in frames: it dominates in cells that were rarely visible."""


class StaticMapTracker(Tracker):
    """Forecasts the occupied rate of each cell among its visible training frames, for every step.

    The map lies in the world: a window takes the part of it that it covers, and the overall rate elsewhere. General
    weights have no map: the forecast is then the rate of each cell in the stream so far.
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
        self._counts = np.zeros((2, *grid.shape))
        """Frames of the stream in which each cell was occupied, and visible (2, M, M)."""
        self._window: SE2 | None = None
        self._map = SiteMap(self.frequency, self._overall, grid.cell_m, self._card.map_pose, grid.size)

    def update(self, frame: GridFrame) -> None:
        """Move to the window of a frame, or count the frame if there is no map."""
        if not self._card.general:
            self._map.at(frame.world_T_grid)
            return
        shift = shift_between(self._window or frame.world_T_grid, frame.world_T_grid, self.stream.grid.cell_m)
        self._window = frame.world_T_grid
        self._counts = rolled(self._counts, shift, 0.0) + np.stack([frame.occupied, frame.visible])

    def predict(self, steps: int) -> Forecast:
        """The rates in the window (steps+1, M, M), the same for every step."""
        rates, (occupied, visible) = self._map.in_window, self._counts
        if self._card.general:
            rates = smoothed_rate(occupied, visible, self._overall, self.options.prior_frames)
        return Forecast(np.tile(rates, (steps + 1, 1, 1)))

    @classmethod
    def fit(cls, task: FitTask) -> None:
        """Count the visible and the occupied frames of every cell in `task.train`, wherever the window went.

        Raises WeightsError if the stretches differ in grid, period or site, no cell is visible, or the map is too
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

    The map has the pose `world_T_map` of its first window, which is None before the first frame.
    """

    def __init__(self, grid: GridSpec) -> None:
        self._grid = grid
        self.visible, self.occupied = np.zeros(grid.shape, np.int64), np.zeros(grid.shape, np.int64)
        self.world_T_map: SE2 | None = None

    def add(self, frame: GridFrame) -> None:
        """Count one frame. Raises WeightsError if the map would have more than MAX_MAP_SIZE cells per side."""
        self.world_T_map = self.world_T_map or frame.world_T_grid
        shift = shift_between(self.world_T_map, frame.world_T_grid, self._grid.cell_m)
        first = tuple(self._grown(axis, by) for axis, by in enumerate(shift))
        window = tuple(slice(start, start + self._grid.size) for start in first)
        self.visible[window] += frame.visible
        self.occupied[window] += frame.occupied

    def _grown(self, axis: int, start: int) -> int:
        """The index of the cell `start` of a window on an axis of the map, which grows to hold the window."""
        size, extent = self._grid.size, self.visible.shape[axis]
        windows_before = -(min(start, 0) // size)
        windows_after = max(-(-(start + size - extent) // size), 0)
        if not windows_before and not windows_after:
            return start
        before, after = windows_before * size, windows_after * size
        if extent + before + after > MAX_MAP_SIZE:
            raise WeightsError(
                f"the window moves over {extent + before + after} cells, and a map has at most"
                f" {MAX_MAP_SIZE} per side: train on a shorter stretch"
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


def smoothed_rate(
    occupied: NDArray[np.floating | np.integer],
    visible: NDArray[np.floating | np.integer],
    overall: float,
    prior_frames: float,
) -> NDArray[np.float32]:
    """P(occupied) (M, M) from counts of frames (M, M), with the `overall` rate as a prior of weight `prior_frames`.

    A cell that was never visible has the overall rate.
    """
    seen = visible + prior_frames
    smoothed = np.full(visible.shape, overall)
    np.divide(occupied + prior_frames * overall, seen, out=smoothed, where=seen > 0)
    return smoothed.astype(np.float32)
