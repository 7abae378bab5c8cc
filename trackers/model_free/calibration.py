"""Calibration of the forecast: what is forecast with a probability is to come that often.

The settings are searched for by F1, which only asks what lies above a threshold: how much is believed of what lies far
below or above it, they leave open. So the log odds of what they forecast are mapped by three numbers, learned from the
training recordings (beta calibration: Kull, Silva Filho and Flach, AISTATS 2017): with a and b positive,

    logit calibrated = c + a ln p - b ln(1 - p).

What was more probable stays more probable, so no threshold decides otherwise than the one that it is mapped to. That is
learned from cells that were seen, and holds for those: of a cell that is hidden now the past traffic is all that is
known, and that was counted.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit, log_expit

from gridtrack.common.errors import WeightsError
from gridtrack.common.grid import GridFrame, Mask
from gridtrack.trackers.contract import Tracker

Array = NDArray[np.float64]

IDENTITY = np.array([1.0, 1.0, 0.0], np.float32)
"""The parameters a, b, c with which nothing is changed."""
LEVELS = 4096
"""Levels of the map from 0 to 1, evenly spread over the square root of the probability: most cells are next to
impossible."""
EVERY = 5
"""A forecast after every fifth frame is counted."""
STRENGTH = 10.0
"""How strongly the identity is held on to: as by so many cells, spread over all levels, that came as it says."""
LEAST = 1e-3
"""The least that a and b may be."""


class Calibration:
    """The map of three `parameters` (3,): a, b, c. Raises WeightsError unless they are finite and a and b positive."""

    def __init__(self, parameters: NDArray[np.float32]) -> None:
        if not (np.isfinite(parameters).all() and (parameters[:2] > 0.0).all()):
            raise WeightsError(
                f"weights: calibration {parameters.tolist()}: a, b and c must be finite, a and b positive; train again"
            )
        self.parameters = tuple(map(float, parameters))
        levels = _levels()
        levels[1:-1] = expit(_features(levels[1:-1]) @ parameters.astype(np.float64))
        self._map = levels.astype(np.float32)
        self.apply(np.zeros((1, 1, 1), np.float32), np.ones((1, 1), np.bool_))  # compiled before the first forecast

    def apply(self, probabilities: NDArray[np.float32], seen: Mask) -> None:
        """Calibrate a forecast (n+1, M, M) in place, in the cells that are `seen` now (M, M). 0 and 1 stay 0 and 1."""
        _apply(probabilities, seen, self._map)


def fit_calibration(stretches: Iterable[tuple[Tracker, Sequence[GridFrame]]], steps: int) -> Calibration:
    """The calibration of trackers that are not calibrated, each on its frames: of what they forecast for 1..steps ahead
    in cells that are seen now and then, the parameters of the highest likelihood.
    """
    counts = sum(_counted(tracker, frames, steps) for tracker, frames in stretches)
    total, came = np.asarray(counts, np.float64)[:, 1:-1]
    said = _levels()[1:-1]
    total, came = total + STRENGTH / len(said), came + STRENGTH / len(said) * said
    features = _features(said)

    def loss(parameters: Array) -> tuple[float, Array]:
        log_odds = features @ parameters
        value = -(came @ log_expit(log_odds) + (total - came) @ log_expit(-log_odds))
        return value / total.sum(), (total * expit(log_odds) - came) @ features / total.sum()

    bounds = [(LEAST, None), (LEAST, None), (None, None)]
    best = minimize(loss, IDENTITY.astype(np.float64), jac=True, bounds=bounds, options={"ftol": 1e-12, "gtol": 1e-8})
    return Calibration(best.x.astype(np.float32))


def _levels() -> Array:
    """The levels (LEVELS+1,), from 0 to 1."""
    return np.linspace(0.0, 1.0, LEVELS + 1) ** 2


def _features(p: Array) -> Array:
    """What the log odds are linear in, (N, 3): ln p, -ln(1 - p) and 1."""
    return np.stack([np.log(p), -np.log1p(-p), np.ones_like(p)], axis=1)


def _counted(tracker: Tracker, frames: Sequence[GridFrame], steps: int) -> NDArray[np.int64]:
    """How many cells, seen now and then, were forecast at each level, and how many were occupied: (2, LEVELS+1)."""
    counts = np.zeros((2, LEVELS + 1), np.int64)
    tracker.reset(seed=0)
    for index, frame in enumerate(frames):
        tracker.update(frame)
        if index % EVERY == 0 and index + steps < len(frames):
            forecast = tracker.predict(steps).occupancy
            for step in range(1, steps + 1):
                later = frames[index + step]
                level = np.rint(np.sqrt(forecast[step]) * LEVELS).astype(np.int64)
                counts[0] += np.bincount(level[frame.visible & later.visible], minlength=LEVELS + 1)
                counts[1] += np.bincount(level[frame.visible & later.occupied], minlength=LEVELS + 1)
    return counts


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def _apply(probabilities, seen, levels):  # type: ignore[no-untyped-def]
    """Map `probabilities` (S, M, M), in place and where `seen` (M, M), to what stands for their nearest level in
    `levels` (LEVELS+1,); what is no probability becomes one.
    """
    last, steps, size = len(levels) - 1, len(probabilities), len(seen)
    for step in range(steps):
        for i in range(size):
            for j in range(size):
                nearest = int(np.int32(np.sqrt(probabilities[step, i, j]) * np.float32(last) + np.float32(0.5)))
                mapped = levels[np.uint64(min(max(nearest, 0), last))]
                probabilities[step, i, j] = mapped if seen[i, j] else probabilities[step, i, j]
