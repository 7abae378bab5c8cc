"""Calibration of the forecast: beta calibration of its probabilities.

The search of a tracker's settings maximises F1 and leaves the probabilities far from the threshold undetermined. Their
log odds are therefore mapped with three parameters, fitted on the training recordings (beta calibration: Kull, Silva
Filho and Flach, AISTATS 2017); with a and b positive,

    logit calibrated = c + a ln p - b ln(1 - p).

There is one map for cells that were seen recently, and one for cells that have been hidden for longer: their forecast
is mainly their occupancy rate. Both are fitted at some times ahead (FITTED_S), to cells that are visible then; the
parameters of a step are interpolated between these. The maps are monotonic.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit, log_expit

from gridtrack.common.config import Settings
from gridtrack.common.errors import WeightsError
from gridtrack.common.grid import GridFrame
from gridtrack.trackers.contract import StreamSpec, Tracker
from gridtrack.trackers.registry import registered_name
from gridtrack.trackers.site_map import marks_in_window
from gridtrack.trackers.training.exported import export_settings
from gridtrack.trackers.training.weights import Weights, array, load_weights, tuned_settings

_Array = NDArray[np.float64]

FITTED_S = (0.25, 0.5, 1.0, 2.0)
"""The times ahead at which maps are fitted, each to the steps nearest to it by their ratio."""
IDENTITY = np.array([[[1.0, 1.0, 0.0]] * 2] * len(FITTED_S), np.float32)
"""The parameters a, b, c of the identity: of cells seen recently, and of others, at each of FITTED_S."""
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
    """A tracker with tuned settings, and forecasts that are calibrated by the time for which a cell has been hidden."""

    learns: ClassVar[bool] = True
    learns_general: ClassVar[bool] = True
    moving_sensor: ClassVar[bool] = True

    def __init__(self, stream: StreamSpec, options: Settings) -> None:
        """Raises WeightsError without weights for the stream's site, grid and period."""
        super().__init__(stream, options)
        self._weights = load_weights(stream, registered_name(type(self)))
        self._settings: Any = tuned_settings(self.Options, self._weights, options)
        self._world_T_map = self._weights.card.map_pose
        self._calibration = Calibration.of(self._weights, stream.period_s)

    def export(self, folder: Path) -> str:
        """Write the tuned settings."""
        return export_settings(folder, self.stream, self._settings)

    @property
    @abstractmethod
    def hidden_s(self) -> NDArray[np.float32]:
        """Time since each cell (M, M) was last seen, seconds; infinite if never."""


class Calibration:
    """The maps with `parameters` (H, 2, 3): a, b and c of cells seen recently, and of others, at each of FITTED_S.

    Steps are `period_s` apart. Raises WeightsError unless the parameters are finite and a and b positive.
    """

    def __init__(self, parameters: NDArray[np.float32], period_s: float) -> None:
        if not (np.isfinite(parameters).all() and (parameters[..., :2] > 0.0).all()):
            raise WeightsError(
                f"weights: calibration {parameters.tolist()}: a, b and c must be finite, a and b positive; train again"
            )
        self._parameters, self._period_s = parameters.astype(np.float64), period_s
        self._maps = np.zeros((0, 2, LEVELS + 1), np.float32)
        self.apply(np.zeros((1, 1, 1), np.float32), np.zeros((1, 1), np.float32))  # compiles the kernel

    @classmethod
    def of(cls, weights: Weights, period_s: float) -> Calibration:
        """The calibration in `weights`; those of version 0.2 have one for all steps. Raises WeightsError."""
        is_one = "calibration" in weights.arrays and weights.arrays["calibration"].ndim == 2
        found = array(weights, "calibration", IDENTITY.shape[1:] if is_one else IDENTITY.shape)
        return cls(np.broadcast_to(found, IDENTITY.shape), period_s)

    def apply(self, probabilities: NDArray[np.float32], hidden_s: NDArray[np.float32]) -> None:
        """Calibrate a forecast (n+1, M, M) in place; `hidden_s` (M, M): time since each cell was seen."""
        if len(self._maps) < len(probabilities):
            self._maps = np.stack([self._maps_at(step) for step in range(len(probabilities))])
        _apply(probabilities, hidden_s < RECENT_S, self._maps)

    def _maps_at(self, step: int) -> NDArray[np.float32]:
        """The maps (2, LEVELS+1) of a step: of cells seen recently, and of others."""
        place = float(np.interp(step * self._period_s, FITTED_S, range(len(FITTED_S))))
        before = min(int(place), len(FITTED_S) - 2)
        share = place - before
        parameters = (1.0 - share) * self._parameters[before] + share * self._parameters[before + 1]
        maps = np.zeros((2, LEVELS + 1), np.float32)
        maps[:, 1:-1] = expit(_features(_levels()[1:-1]) @ parameters.T).T
        maps[:, -1] = 1.0
        return maps


def fit_calibration(
    stretches: Iterable[tuple[CalibratedTracker, Sequence[GridFrame], int]],
) -> NDArray[np.float32]:
    """Maximum-likelihood parameters (H, 2, 3), from trackers without calibration, each on its frames.

    Counted are their forecasts at steps 1 to the number of steps of each in the cells that are visible then.
    """
    counts = sum((_counts(*stretch) for stretch in stretches), np.zeros((len(FITTED_S), 2, 2, LEVELS + 1)))
    fitted = [
        [_maximum_likelihood(total[1:-1], occupied[1:-1]) for total, occupied in at_a_time] for at_a_time in counts
    ]
    return np.array(fitted, np.float32)


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
    start = IDENTITY[0, 0].astype(np.float64)
    best = minimize(loss, start, jac=True, bounds=bounds, options={"ftol": 1e-12, "gtol": 1e-8})
    return np.asarray(best.x)


def _levels() -> _Array:
    """The levels (LEVELS+1,), from 0 to 1."""
    return np.linspace(0.0, 1.0, LEVELS + 1) ** 2


def _features(p: _Array) -> _Array:
    """Features in which the log odds are linear (N, 3): ln p, -ln(1 - p) and 1."""
    return np.stack([np.log(p), -np.log1p(-p), np.ones_like(p)], axis=1)


def _counts(tracker: CalibratedTracker, frames: Sequence[GridFrame], steps: int) -> _Array:
    """Numbers of visible and of occupied cells at each forecast level, (H, 2, 2, LEVELS+1).

    The first axes: the steps nearest to each of FITTED_S; cells seen recently at the time of the forecast, other cells.
    """
    counts = np.zeros((len(FITTED_S), 2, 2, LEVELS + 1))
    between_s = np.sqrt(np.multiply(FITTED_S[1:], FITTED_S[:-1]))
    at_time = np.searchsorted(between_s, tracker.stream.period_s * np.arange(1, steps + 1))
    tracker.reset(seed=0)
    for index, frame in enumerate(frames):
        tracker.update(frame)
        if index % COUNT_EVERY == 0 and index + steps < len(frames):
            levels = np.rint(np.sqrt(tracker.predict(steps).occupancy) * LEVELS).astype(np.int64)
            recent = tracker.hidden_s < RECENT_S
            for k, level, later in zip(at_time, levels[1:], frames[index + 1 :], strict=False):
                marks = np.stack([later.visible, later.occupied])
                visible, occupied = marks_in_window(frame.world_T_grid, later, marks, tracker.stream.grid.cell_m)
                for count, group in zip(counts[k], (recent, ~recent), strict=True):
                    count[0] += np.bincount(level[group & visible], minlength=LEVELS + 1)
                    count[1] += np.bincount(level[group & occupied], minlength=LEVELS + 1)
    return counts


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def _apply(probabilities, recent, maps):  # type: ignore[no-untyped-def]
    """Map `probabilities` (S, M, M) in place by their nearest level in the `maps` (S, 2, LEVELS+1) of each step.

    The first map is for the cells seen `recent` (M, M); values outside [0, 1] are mapped like 0 or 1.
    """
    last, size = maps.shape[2] - 1, len(recent)
    for step in range(len(probabilities)):
        for i in range(size):
            for j in range(size):
                nearest = int(np.int32(np.sqrt(probabilities[step, i, j]) * np.float32(last) + np.float32(0.5)))
                level = np.uint64(min(max(nearest, 0), last))
                probabilities[step, i, j] = maps[step, 0, level] if recent[i, j] else maps[step, 1, level]
