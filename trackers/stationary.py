"""The floor `stationary`: P(occupied) from a table that was learned without motion."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from gridtrack.common.config import Settings
from gridtrack.common.errors import ConfigurationError
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec, Mask, nearest_step, rolled, shift_between
from gridtrack.trackers.contract import FitTask, Forecast, FrameSource, StreamSpec, Tracker
from gridtrack.trackers.registry import registered_name
from gridtrack.trackers.site_map import marks_in_window
from gridtrack.trackers.training.card import card_for
from gridtrack.trackers.training.weights import array, load_weights, save_weights

TABLE_HORIZONS_S = np.array([0.0, 0.1, 0.2, 0.3, 0.5, 0.75, 1.0, 1.5, 2.0, 2.5])
"""Horizons of the table; between them it is interpolated, and beyond the last one it stays."""
RATE_ENDS = np.array([0.0, 0.01, 0.03, 0.1, 0.2, 0.5, 0.8])
"""Upper ends of the bins of the occupied rate of a cell so far; one more bin is beyond the last."""
DISTANCE_ENDS_M = np.array([0.05, 0.25, 0.45, 0.65, 0.85, 1.1, 1.5, 2.0, 3.0, 5.0])
"""Upper ends of the bins of the distance to the nearest non-static return of the newest frame; one more is beyond."""
AGE_ENDS_S = np.array([0.0, 0.25, 0.5, 1.0, 2.0, 4.0, 1e6])
"""Upper ends of the bins of the time since a cell was visible; one more has the cells that were never visible."""
TABLE_BINS = len(RATE_ENDS) + 1, len(DISTANCE_ENDS_M) + 1, len(AGE_ENDS_S) + 1
"""Numbers of bins of rate, distance and age in the table at one horizon."""
STATIC_RATE = 0.5
"""A return is static in a cell that was occupied in more than this share of its visible frames."""
LEARN_AFTER, LEARN_EVERY_S = 20, 0.5
"""Frames before the first forecast that is learned from, and the time between two of them."""
DISTANCE_PRIOR_CELLS = 20.0
"""Weight, in cells, of the rate over all distances as a prior of the rate at one distance."""
_NEVER_NS = np.iinfo(np.int64).min // 2
_Made = TypeVar("_Made")


class StationaryTracker(Tracker):
    """Forecasts the learned occupied rate of cells with the same past: rate, distance to returns, time since seen.

    It has no notion of motion, but knows how sure the last frame is: cells near a moving return are less sure to stay
    free, and a return is less sure to stay, the further ahead.
    """

    moving_sensor = True
    learns = True
    learns_general = True
    role = "floor"

    def __init__(self, stream: StreamSpec, options: Settings) -> None:
        """Raises WeightsError without weights."""
        super().__init__(stream, options)
        weights = load_weights(stream, registered_name(type(self)))
        self._table = array(weights, "occupied", (len(TABLE_HORIZONS_S), *TABLE_BINS)).reshape(
            len(TABLE_HORIZONS_S), -1
        )
        self._rates = np.zeros((0, self._table.shape[1]), np.float32)
        self.reset(seed=0)

    def reset(self, seed: int) -> None:
        """No cell has been observed."""
        self._past = CellPasts(self.stream.grid)

    def update(self, frame: GridFrame) -> None:
        """Add a frame to the past of the cells."""
        self._past.add(frame)

    def predict(self, steps: int) -> Forecast:
        """The rates of the table (steps+1, M, M) for the past of each cell."""
        if len(self._rates) <= steps:  # a trial asks for as many steps each time
            self._rates = self._rates_of(steps)
        return Forecast(self._rates[: steps + 1, self._past.bins()])

    def _rates_of(self, steps: int) -> NDArray[np.float32]:
        """The rates (steps+1, bins) of the table at each step."""
        horizons_s = np.arange(steps + 1) * self.stream.period_s
        rates = [np.interp(horizons_s, TABLE_HORIZONS_S, of_bin) for of_bin in self._table.T]
        return np.stack(rates, axis=1).astype(np.float32)

    @classmethod
    def fit(cls, task: FitTask) -> None:
        """Count in `task.train` how often the cells of each bin are occupied at each horizon, if they are visible.

        Raises ConfigurationError for a training at a site: the table has nothing of a place.
        """
        if not task.general:
            raise ConfigurationError(
                "stationary learns for any place: add --general, and name recordings of many sites"
            )
        counts = np.zeros((2, len(TABLE_HORIZONS_S), np.prod(TABLE_BINS)))
        for source in task.train:
            counts += counts_of(source)
        visible, occupied = counts.reshape(2, len(TABLE_HORIZONS_S), *TABLE_BINS)
        card = card_for(registered_name(cls), task, {})
        save_weights(task.out, card, {"occupied": smoothed_rates(occupied, visible)})
        task.report(
            f"{card.tracker}: {visible.sum():.3g} cells counted, overall rate {occupied.sum() / visible.sum():.4f}"
        )


class CellPasts:
    """Observations of each cell of the window so far; each cell keeps its place in the world."""

    def __init__(self, grid: GridSpec) -> None:
        self._grid = grid
        self._visible, self._occupied = np.zeros((2, *grid.shape), np.float32)
        """Frames in which each cell (M, M) was visible, and occupied."""
        self._seen_ns = np.full(grid.shape, _NEVER_NS)
        """Stamp at which each cell (M, M) was last visible."""
        self._returns: Mask = np.zeros(grid.shape, np.bool_)
        self._window: SE2 | None = None
        self._now_ns = 0

    def add(self, frame: GridFrame) -> None:
        """Count a frame; cells that come into the window were never visible."""
        shift = shift_between(self._window or frame.world_T_grid, frame.world_T_grid, self._grid.cell_m)
        if shift:
            self._visible, self._occupied = (rolled(own, shift, 0.0) for own in (self._visible, self._occupied))
            self._seen_ns = rolled(self._seen_ns, shift, _NEVER_NS)
        self._window, self._now_ns = frame.world_T_grid, frame.stamp_ns
        self._visible += frame.visible
        self._occupied += frame.occupied
        self._seen_ns[frame.visible] = frame.stamp_ns
        self._returns = frame.occupied

    def bins(self) -> NDArray[np.int64]:
        """The bin of each cell (M, M), an index into the bins of one horizon in C order."""
        rate = self._occupied / np.maximum(self._visible, 1.0)
        moving = self._returns & (rate <= STATIC_RATE)
        distance_m = np.full(self._grid.shape, np.inf)
        if moving.any():
            distance_m = distance_transform_edt(~moving, self._grid.cell_m)
        age_s = np.where(self._visible > 0, (self._now_ns - self._seen_ns) / 1e9, np.inf)
        by_axis = (RATE_ENDS, rate), (DISTANCE_ENDS_M, distance_m), (AGE_ENDS_S, age_s)
        return np.ravel_multi_index([ends.searchsorted(values) for ends, values in by_axis], TABLE_BINS)


def counts_of(source: FrameSource) -> NDArray[np.float64]:
    """Cells of each bin (2, horizons, bins) that were visible, and occupied, at each horizon after a forecast."""
    counts = np.zeros((2, len(TABLE_HORIZONS_S), np.prod(TABLE_BINS)))
    past = CellPasts(source.grid)
    for bins, horizons, marks in observed_later(source, TABLE_HORIZONS_S, past.add, past.bins):
        counted = [np.bincount(bins[mask], minlength=int(np.prod(TABLE_BINS))) for mask in marks]
        counts[:, horizons] += np.stack(counted)[:, None]
    return counts


def observed_later(
    source: FrameSource,
    horizons_s: NDArray[np.float64],
    observe: Callable[[GridFrame], None],
    forecast: Callable[[], _Made],
) -> Iterator[tuple[_Made, Sequence[int], Mask]]:
    """Each `forecast` to learn from, the numbers of the `horizons_s` that a later frame has, and what it shows.

    The visible and the occupied cells (2, M, M) of the later frame are in the window of the forecast. `observe` is
    called with each frame.
    """
    steps = horizon_steps(horizons_s, source)
    recent: deque[tuple[int, SE2, _Made]] = deque()
    for index, frame in enumerate(source):
        observe(frame)
        if index >= LEARN_AFTER and index % frames_between(source) == 0:
            recent.append((index, frame.world_T_grid, forecast()))
        while recent and recent[0][0] + max(steps) < index:
            recent.popleft()
        for made_at, window, made in recent:
            at = [horizon for horizon, step in enumerate(steps) if step == index - made_at]
            if at:
                marks = np.stack([frame.visible, frame.occupied])
                yield made, at, marks_in_window(window, frame, marks, source.grid.cell_m)


def horizon_steps(horizons_s: NDArray[np.float64], source: FrameSource) -> list[int]:
    """The step nearest to each horizon; 0 for one that is nearer to the present."""
    return [nearest_step(horizon_s, source.period_s) for horizon_s in horizons_s]


def frames_between(source: FrameSource) -> int:
    """Frames between two forecasts to learn from."""
    return max(1, nearest_step(LEARN_EVERY_S, source.period_s))


def smoothed_rates(occupied: NDArray[np.float64], visible: NDArray[np.float64]) -> NDArray[np.float32]:
    """The occupied rate (horizons, rates, distances, ages) float32 of counts of the same shape.

    The prior of a bin is the rate over all distances; its prior is the rate of all cells at the horizon.
    """
    rates = occupied.sum((1, 2, 3), keepdims=True) / np.maximum(visible.sum((1, 2, 3), keepdims=True), 1.0)
    for found, seen in ((one.sum(axis=2, keepdims=True) for one in (occupied, visible)), (occupied, visible)):
        rates = (found + DISTANCE_PRIOR_CELLS * rates) / (seen + DISTANCE_PRIOR_CELLS)
    return np.asarray(rates, np.float32)
