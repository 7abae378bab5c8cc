"""Calibration of the forecast: beta calibration of its probabilities.

The search of a tracker's settings maximises F1 and leaves the probabilities far from the threshold undetermined. Their
log odds are therefore mapped with three parameters, fitted on the training recordings (beta calibration: Kull, Silva
Filho and Flach, AISTATS 2017); with a and b positive,

    logit calibrated = c + a ln p - b ln(1 - p).

There is one map for cells that were seen recently, and one for cells that have been hidden for longer: their forecast
is mainly their occupancy rate; both are fitted to cells that are visible at the forecast step. The maps are monotonic.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Sequence

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit, log_expit

from gridtrack.common.errors import WeightsError
from gridtrack.common.grid import GridFrame
from gridtrack.trackers.contract import Tracker
from gridtrack.trackers.site_map import marks_in_window

_Array = NDArray[np.float64]

IDENTITY = np.array([[1.0, 1.0, 0.0]] * 2, np.float32)
"""The parameters a, b, c of the identity: of cells seen recently, and of others."""
LEVELS = 4096
"""Number of levels of the map from 0 to 1, uniform in the square root of the probability: most values are near 0."""
COUNT_EVERY = 5
"""Frames between the forecasts that are counted."""
PRIOR_CELLS = 10.0
"""Weight of the prior for the identity, in cells, distributed over all levels."""
RECENT_S = 1.0
"""A cell was seen recently if it was seen within this time."""
MIN_SLOPE = 1e-3
"""Lower bound of a and b."""


class CalibratedTracker(Tracker):
    """A tracker with forecasts that are calibrated by the time for which a cell has been hidden."""

    @property
    @abstractmethod
    def hidden_s(self) -> NDArray[np.float32]:
        """Time since each cell (M, M) was last seen, seconds; infinite if never."""


class Calibration:
    """The maps with `parameters` (2, 3): a, b and c of cells seen recently, and of others.

    Raises WeightsError unless they are finite and a and b positive.
    """

    def __init__(self, parameters: NDArray[np.float32]) -> None:
        if not (np.isfinite(parameters).all() and (parameters[:, :2] > 0.0).all()):
            raise WeightsError(
                f"weights: calibration {parameters.tolist()}: a, b and c must be finite, a and b positive; train again"
            )
        self._maps = np.zeros((2, LEVELS + 1), np.float32)
        self._maps[:, 1:-1] = expit(_features(_levels()[1:-1]) @ parameters.T.astype(np.float64)).T
        self._maps[:, -1] = 1.0
        self.apply(np.zeros((1, 1, 1), np.float32), np.zeros((1, 1), np.float32))  # compiles the kernel

    def apply(self, probabilities: NDArray[np.float32], hidden_s: NDArray[np.float32]) -> None:
        """Calibrate a forecast (n+1, M, M) in place; `hidden_s` (M, M): time since each cell was seen."""
        _apply(probabilities, hidden_s < RECENT_S, self._maps)


def fit_calibration(
    stretches: Iterable[tuple[CalibratedTracker, Sequence[GridFrame], int]],
) -> NDArray[np.float32]:
    """Maximum-likelihood parameters (2, 3), from trackers without calibration, each on its frames.

    Counted are their forecasts at steps 1 to the number of steps of each in the cells that are visible then.
    """
    counts = sum((_counts(*stretch) for stretch in stretches), np.zeros((2, 2, LEVELS + 1)))
    return np.array([_maximum_likelihood(total[1:-1], occupied[1:-1]) for total, occupied in counts], np.float32)


def _maximum_likelihood(total: _Array, occupied: _Array) -> _Array:
    """The parameters (3,), from the numbers of forecasts `total` and of `occupied` cells of each inner level."""
    forecast = _levels()[1:-1]
    total, occupied = total + PRIOR_CELLS / len(forecast), occupied + PRIOR_CELLS / len(forecast) * forecast
    features = _features(forecast)

    def loss(parameters: _Array) -> tuple[float, _Array]:
        log_odds = features @ parameters
        value = -(occupied @ log_expit(log_odds) + (total - occupied) @ log_expit(-log_odds))
        return value / total.sum(), (total * expit(log_odds) - occupied) @ features / total.sum()

    bounds = [(MIN_SLOPE, None), (MIN_SLOPE, None), (None, None)]
    start = IDENTITY[0].astype(np.float64)
    best = minimize(loss, start, jac=True, bounds=bounds, options={"ftol": 1e-12, "gtol": 1e-8})
    return np.asarray(best.x)


def _levels() -> _Array:
    """The levels (LEVELS+1,), from 0 to 1."""
    return np.linspace(0.0, 1.0, LEVELS + 1) ** 2


def _features(p: _Array) -> _Array:
    """Features in which the log odds are linear (N, 3): ln p, -ln(1 - p) and 1."""
    return np.stack([np.log(p), -np.log1p(-p), np.ones_like(p)], axis=1)


def _counts(tracker: CalibratedTracker, frames: Sequence[GridFrame], steps: int) -> _Array:
    """Numbers of visible and of occupied cells at each forecast level, (2, 2, LEVELS+1).

    The first axis: cells seen recently at the time of the forecast, other cells.
    """
    counts = np.zeros((2, 2, LEVELS + 1))
    tracker.reset(seed=0)
    for index, frame in enumerate(frames):
        tracker.update(frame)
        if index % COUNT_EVERY == 0 and index + steps < len(frames):
            levels = np.rint(np.sqrt(tracker.predict(steps).occupancy) * LEVELS).astype(np.int64)
            recent = tracker.hidden_s < RECENT_S
            for level, later in zip(levels[1:], frames[index + 1 :], strict=False):
                marks = np.stack([later.visible, later.occupied])
                visible, occupied = marks_in_window(frame.world_T_grid, later, marks, tracker.stream.grid.cell_m)
                for count, group in zip(counts, (recent, ~recent), strict=True):
                    count[0] += np.bincount(level[group & visible], minlength=LEVELS + 1)
                    count[1] += np.bincount(level[group & occupied], minlength=LEVELS + 1)
    return counts


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def _apply(probabilities, recent, maps):  # type: ignore[no-untyped-def]
    """Map `probabilities` (S, M, M) in place by their nearest level in `maps` (2, LEVELS+1).

    The first map is for the cells seen `recent` (M, M); values outside [0, 1] are mapped like 0 or 1.
    """
    last, size = maps.shape[1] - 1, len(recent)
    for step in range(len(probabilities)):
        for i in range(size):
            for j in range(size):
                nearest = int(np.int32(np.sqrt(probabilities[step, i, j]) * np.float32(last) + np.float32(0.5)))
                level = np.uint64(min(max(nearest, 0), last))
                probabilities[step, i, j] = maps[0, level] if recent[i, j] else maps[1, level]
