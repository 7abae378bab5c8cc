"""Calibration of the forecast: what is forecast with a probability is to come that often.

The settings are searched for by F1, which only asks what lies above a threshold: how much is believed of what lies far
below or above it, they leave open. So the log odds of what they forecast are mapped by three numbers, learned from the
training recordings (beta calibration: Kull, Silva Filho and Flach, AISTATS 2017): with a and b positive,

    logit calibrated = c + a ln p - b ln(1 - p).

There are three for cells that were seen of late, and three for those that have been hidden for longer, of which little
but the past traffic is known; both are learned from cells that are seen when it comes. Among the cells of one kind what
was more probable stays more probable.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit, log_expit

from gridtrack.common.errors import WeightsError
from gridtrack.common.grid import GridFrame
from gridtrack.trackers.model_free.arrays import Array

if TYPE_CHECKING:
    from gridtrack.trackers.model_free.tracker import ModelFreeTracker


IDENTITY = np.array([[1.0, 1.0, 0.0]] * 2, np.float32)
"""The parameters a, b, c with which nothing is changed: of cells seen of late, and of others."""
LEVELS = 4096
"""Levels of the map from 0 to 1, evenly spread over the square root of the probability: most cells are next to
impossible."""
EVERY = 5
"""A forecast after every fifth frame is counted."""
STRENGTH = 10.0
"""How strongly the identity is held on to: as by so many cells, spread over all levels, that came as it says."""
OF_LATE_S = 1.0
"""A cell that was seen within this time was seen of late."""
LEAST = 1e-3
"""The least that a and b may be."""


class Calibration:
    """The maps of `parameters` (2, 3): a, b and c of cells seen of late, and of others.

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
        self.apply(np.zeros((1, 1, 1), np.float32), np.zeros((1, 1), np.float32))  # compiled before the first forecast

    def apply(self, probabilities: NDArray[np.float32], hidden_s: NDArray[np.float32]) -> None:
        """Calibrate a forecast (n+1, M, M) in place; each cell was seen `hidden_s` (M, M) ago. 0 and 1 stay 0 and 1."""
        _apply(probabilities, hidden_s < OF_LATE_S, self._maps)


def fit_calibration(
    stretches: Iterable[tuple[ModelFreeTracker, Sequence[GridFrame]]], steps: int
) -> NDArray[np.float32]:
    """The parameters (2, 3) of the highest likelihood, of trackers that are not calibrated, each on its frames.

    Counted is what they forecast for 1..steps ahead in the cells that are visible then.
    """
    counts = sum((_counted(*stretch, steps) for stretch in stretches), np.zeros((2, 2, LEVELS + 1)))
    return np.array([_most_likely(total[1:-1], came[1:-1]) for total, came in counts], np.float32)


def _most_likely(total: Array, came: Array) -> Array:
    """The parameters (3,), where of `total` (LEVELS-1,) forecasts of each inner level `came` (LEVELS-1,) came."""
    said = _levels()[1:-1]
    total, came = total + STRENGTH / len(said), came + STRENGTH / len(said) * said
    features = _features(said)

    def loss(parameters: Array) -> tuple[float, Array]:
        log_odds = features @ parameters
        value = -(came @ log_expit(log_odds) + (total - came) @ log_expit(-log_odds))
        return value / total.sum(), (total * expit(log_odds) - came) @ features / total.sum()

    bounds = [(LEAST, None), (LEAST, None), (None, None)]
    start = IDENTITY[0].astype(np.float64)
    best = minimize(loss, start, jac=True, bounds=bounds, options={"ftol": 1e-12, "gtol": 1e-8})
    return np.asarray(best.x)


def _levels() -> Array:
    """The levels (LEVELS+1,), from 0 to 1."""
    return np.linspace(0.0, 1.0, LEVELS + 1) ** 2


def _features(p: Array) -> Array:
    """What the log odds are linear in, (N, 3): ln p, -ln(1 - p) and 1."""
    return np.stack([np.log(p), -np.log1p(-p), np.ones_like(p)], axis=1)


def _counted(tracker: ModelFreeTracker, frames: Sequence[GridFrame], steps: int) -> Array:
    """How many visible cells were forecast at each level, and how many were occupied: (2, 2, LEVELS+1).

    First those that had been seen of late at the time of the forecast, then the others.
    """
    counts = np.zeros((2, 2, LEVELS + 1))
    tracker.reset(seed=0)
    for index, frame in enumerate(frames):
        tracker.update(frame)
        if index % EVERY == 0 and index + steps < len(frames):
            levels = np.rint(np.sqrt(tracker.predict(steps).occupancy) * LEVELS).astype(np.int64)
            of_late = tracker.hidden_s < OF_LATE_S
            for level, later in zip(levels[1:], frames[index + 1 :], strict=False):
                for count, kind in zip(counts, (of_late, ~of_late), strict=True):
                    count[0] += np.bincount(level[kind & later.visible], minlength=LEVELS + 1)
                    count[1] += np.bincount(level[kind & later.occupied], minlength=LEVELS + 1)
    return counts


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def _apply(probabilities, of_late, maps):  # type: ignore[no-untyped-def]
    """Map `probabilities` (S, M, M), in place, to what stands for their nearest level in the first of the `maps`
    (2, LEVELS+1), or where they were not seen `of_late` (M, M) in the second; what is no probability becomes one.
    """
    last, size = maps.shape[1] - 1, len(of_late)
    for step in range(len(probabilities)):
        for i in range(size):
            for j in range(size):
                nearest = int(np.int32(np.sqrt(probabilities[step, i, j]) * np.float32(last) + np.float32(0.5)))
                level = np.uint64(min(max(nearest, 0), last))
                probabilities[step, i, j] = maps[0, level] if of_late[i, j] else maps[1, level]
