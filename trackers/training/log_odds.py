"""Logarithmic opinion pool: weights for the log odds of several forecasts, fitted by log loss.

The forecasts p_i of a cell are combined to sigmoid(offset + sum_i weight_i logit p_i) (Genest and Zidek, *Statistical
Science* 1, 1986). Weights and offset depend on the horizon (stacked generalisation: Wolpert, *Neural Networks* 5,
1992). They are the same for cells that are hidden at the time of the forecast: only those that come into view are
observed, which are more often occupied than those that stay hidden.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit, log_expit

from gridtrack.common.grid import Mask

POOL_HORIZONS_S = np.array([0.1, 0.25, 0.5, 1.0, 1.5, 2.0, 2.5])
"""Horizons of the weights; between them they are interpolated, and outside of them they stay."""
LEAST_ODDS = 1e-4
"""Probabilities are clipped to [LEAST_ODDS, 1 - LEAST_ODDS]: a forecast of 0 or 1 would decide alone."""
LIKELY = 0.02
"""A cell is likely occupied if a forecast is above this."""
PRIOR_WEIGHT = 10.0
"""Weight, in cells, of the squared distance to the mean of the log odds."""

_Array = NDArray[np.float64]
Odds = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class SampledCells:
    """Cells (C,) that were visible at a horizon after a forecast.

    `odds` (C, N): the log odds of N forecasts. `horizon` (C,): index of POOL_HORIZONS_S. `occupied` (C,): at the
    horizon. `stands_for` (C,): number of visible cells.
    """

    odds: Odds
    horizon: NDArray[np.int8]
    occupied: Mask
    stands_for: NDArray[np.float32]

    @classmethod
    def empty(cls, number: int) -> SampledCells:
        """No cells of `number` forecasts."""
        none = np.zeros(0, np.bool_)
        return cls(np.zeros((0, number), np.float32), none.astype(np.int8), none, none.astype(np.float32))

    @classmethod
    def together(cls, parts: Sequence[SampledCells]) -> SampledCells:
        """The cells of all `parts`, at least one."""
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in cls.__slots__))

    def at(self, horizon: int) -> SampledCells:
        """The cells at one horizon."""
        chosen = self.horizon == horizon
        return SampledCells(*(getattr(self, name)[chosen] for name in self.__slots__))


def log_odds(probabilities: NDArray[np.floating]) -> Odds:
    """The log odds, of the same shape, of probabilities that are not closer to 0 or 1 than LEAST_ODDS."""
    p = np.clip(probabilities, LEAST_ODDS, 1.0 - LEAST_ODDS, dtype=np.float32)
    return np.asarray(np.log(p) - np.log1p(-p), np.float32)


def sample(
    odds: Odds, horizon: int, visible: Mask, occupied: Mask, most: int, draw: np.random.Generator
) -> SampledCells:
    """At most about `most` of the visible cells that are likely occupied or occupied, and of the others.

    `odds` (N, M, M): of N forecasts at a `horizon`, at which the cells are `visible` and `occupied` (M, M).
    """
    likely = visible & (occupied | (odds.max(axis=0) > np.log(LIKELY / (1.0 - LIKELY))))
    parts = []
    for kind in (likely, visible & ~likely):
        cells = np.flatnonzero(kind)
        share = min(1.0, most / max(len(cells), 1))
        cells = cells[draw.random(len(cells)) < share]
        parts.append(
            SampledCells(
                odds.reshape(len(odds), -1)[:, cells].T,
                np.full(len(cells), horizon, np.int8),
                occupied.ravel()[cells],
                np.full(len(cells), 1.0 / share, np.float32),
            )
        )
    return SampledCells.together(parts)


def fit_pool(cells: SampledCells) -> tuple[_Array, _Array]:
    """The weights (K, N) and offsets (K,) of least log loss at each horizon.

    Weights are not negative; with few cells they are near those of the mean of the log odds. A horizon without cells
    has the weights of the nearest one with some.
    """
    by_horizon = [cells.at(horizon) for horizon in range(len(POOL_HORIZONS_S))]
    known = [n for n, part in enumerate(by_horizon) if part.occupied.size] or [0]
    fitted = {n: _maximum_likelihood(by_horizon[n]) for n in known}
    nearest = np.array([fitted[min(known, key=lambda one: abs(one - n))] for n in range(len(by_horizon))])
    return nearest[:, :-1], nearest[:, -1]


def _maximum_likelihood(cells: SampledCells) -> _Array:
    """The weights and the offset (N+1,) of cells of one horizon; those of the mean without cells."""
    number = cells.odds.shape[1]
    mean = np.append(np.full(number, 1.0 / number), 0.0)
    features = np.column_stack([cells.odds, np.ones(len(cells.odds), np.float32)]).astype(np.float64)
    occupied, weight = cells.occupied.astype(np.float64), cells.stands_for.astype(np.float64)
    total = weight.sum() + PRIOR_WEIGHT

    def loss(parameters: _Array) -> tuple[float, _Array]:
        combined, off = features @ parameters, parameters - mean
        value = -weight @ np.where(occupied, log_expit(combined), log_expit(-combined)) + PRIOR_WEIGHT * off @ off
        gradient = (weight * (expit(combined) - occupied)) @ features + 2.0 * PRIOR_WEIGHT * off
        return value / total, gradient / total

    bounds = [(0.0, None)] * number + [(None, None)]
    best = minimize(loss, mean, jac=True, bounds=bounds, options={"ftol": 1e-12, "gtol": 1e-8})
    return np.asarray(best.x)


def log_losses(cells: SampledCells, combined: Odds) -> _Array:
    """The mean log loss (K,) of forecasts with the log odds `combined` (C,), nats a cell; NaN without cells."""
    losses = -cells.stands_for * log_expit(np.where(cells.occupied, combined, -combined))
    sums, counts = (
        np.bincount(cells.horizon, weights=values, minlength=len(POOL_HORIZONS_S))
        for values in (losses, cells.stands_for)
    )
    return np.asarray(np.divide(sums, counts, out=np.full(len(sums), np.nan), where=counts > 0))


def combined_odds(cells: SampledCells, weights: _Array, offsets: _Array) -> Odds:
    """The log odds (C,) of the pool with `weights` (K, N) and `offsets` (K,)."""
    combined = (weights[cells.horizon] * cells.odds).sum(axis=1) + offsets[cells.horizon]
    return np.asarray(combined, np.float32)
