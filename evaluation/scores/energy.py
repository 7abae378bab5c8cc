"""The energy score of sampled futures, against the cells that are visible when the step has come.

Gneiting and Raftery, Journal of the American Statistical Association 102 (2007), equation 22: the mean distance of the
futures from the observed frame, less half their mean distance from each other. The second mean is over pairs of
different futures, so that the expected score does not depend on their number (Ferro, Quarterly Journal of the Royal
Meteorological Society 140, 2014).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.referee.referee import ScoredForecast
from gridtrack.evaluation.referee.targets import SEEN_OCCUPIED, cell_regions, members
from gridtrack.evaluation.scores.definition import (
    Floats,
    Measure,
    Output,
    Ratio,
    ScoreDefinition,
    Sums,
    TrialFacts,
    divided,
)

ENERGY_STRATA = ("visible", "dynamic", "in-motion")
"""The strata that have energy scores."""
_GROUPS, _GROUP_OF = np.unique(members(ENERGY_STRATA).T, axis=0, return_inverse=True)
"""Regions that are part of the same strata (groups, strata), and the group of each region: cells are added up once."""


def _count(forecast: ScoredForecast, facts: TrialFacts, memory: None) -> Floats | None:
    """Sums (S, K, 3): 1 where the stratum has cells, the mean distance of the futures (F, steps+1, M, M) from the
    observed frame, and half their mean distance from each other.
    """
    futures = forecast.forecast.futures
    if futures is None:
        return None
    sums = np.zeros((len(forecast.targets), len(ENERGY_STRATA), 3))
    number: type[np.floating] = np.float32 if futures.dtype == np.bool_ else np.float64  # sums of 0 and 1 are exact
    for n, target in enumerate(forecast.targets):
        group = _GROUP_OF[cell_regions(target, forecast.region_maps, forecast.ages).ravel()]
        came = target.state.reshape(1, -1) == SEEN_OCCUPIED
        vectors: NDArray[Any] = np.concatenate([futures[:, n].reshape(len(futures), -1), came]).astype(number)
        products, cells = np.zeros((len(_GROUPS), *[len(vectors)] * 2)), np.bincount(group, minlength=len(_GROUPS))
        for g in np.flatnonzero(_GROUPS.any(axis=1)):
            own = vectors.take(np.flatnonzero(group == g), axis=1)
            products[g] = own @ own.T
        for k, of_groups in enumerate(_GROUPS.T):
            if counted := cells[of_groups].sum():
                sums[n, k] = 1.0, *distance_and_spread(products[of_groups].sum(axis=0), counted)
    return sums


def distance_and_spread(products: NDArray[np.float64], cells: int) -> tuple[float, float]:
    """The two terms of the score, of the scalar products (F+1, F+1) of F futures and, last, of the observed frame, over
    `cells`.

    A distance is the root of the mean squared difference over the cells: the Euclidean one over the root of their
    number.
    """
    squares = products.diagonal()
    distances = np.sqrt(np.maximum(squares[:, None] + squares - 2.0 * products, 0.0) / cells)
    count = len(products) - 1
    apart = distances[:-1, :-1][~np.eye(count, dtype=np.bool_)]
    return float(distances[-1, :-1].mean()), float(apart.mean() / 2)


def _value(sums: Sums) -> Mapping[str, Ratio | Measure]:
    forecasts, distance, spread = sums["forecasts"], sums["distance"], sums["spread"]
    return {
        "score": Measure(divided(distance, forecasts) - divided(spread, forecasts), forecasts),
        "spread": Ratio(spread, forecasts),
    }


ENERGY = ScoreDefinition(
    name="energy",
    title="Energy score",
    position=100,
    outputs=(
        Output("score", "Energy score", better="lower", scale="linear"),
        Output("spread", "Spread of futures", scale="log"),
    ),
    about="Mean distance of the sampled futures from the observed frame, less half their mean distance from each other."
    " Proper: it is lowest for futures drawn from what may truly happen, all cells together. The spread is 0 where the"
    " futures are all alike. Gneiting and Raftery, 2007.",
    strata=lambda facts: ENERGY_STRATA,
    parts=lambda facts: ("forecasts", "distance", "spread"),
    count=_count,
    value=_value,
    needed="sampled futures of the forecast",
)
