"""The energy score of sampled futures, against the cells that are visible when the step has come.

Gneiting and Raftery, Journal of the American Statistical Association 102 (2007), equation 22: the mean distance of the
futures from what came, less half their mean distance from each other. The second mean is over pairs of different
futures, so that the expected score does not depend on their number (Ferro, Quarterly Journal of the Royal
Meteorological Society 140, 2014).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.scoring.neighbourhoods import NO_REGION, cell_regions
from gridtrack.evaluation.scoring.strata import REGIONS, STRATA_WITH_TRUTH, SUMS_OF_REGIONS, RegionMaps
from gridtrack.evaluation.scoring.target import SEEN_OCCUPIED, Target

ENERGY_STRATA = ("visible", "dynamic", "in-motion")
"""The strata that have energy scores."""
_MEMBER_OF = np.zeros((len(ENERGY_STRATA), REGIONS + 1), np.bool_)
_MEMBER_OF[:, :NO_REGION] = SUMS_OF_REGIONS[[STRATA_WITH_TRUTH.index(name) for name in ENERGY_STRATA]]
_GROUPS, _GROUP_OF = np.unique(_MEMBER_OF.T, axis=0, return_inverse=True)
"""Regions that are part of the same strata (groups, strata), and the group of each region: cells are added up once."""


@dataclass(frozen=True, slots=True)
class EnergyTerms:
    """The two terms of the score of one forecast, per step S = steps+1 and stratum K of ENERGY_STRATA, each (S, K).

    `forecasts`: 1 where the stratum has cells, else 0; `distance`: mean distance of the futures from what came;
    `spread`: half their mean distance from each other. The score is `distance` - `spread`.
    """

    forecasts: NDArray[np.int64]
    distance: NDArray[np.float64]
    spread: NDArray[np.float64]


def energy_terms(
    futures: NDArray[np.bool_] | NDArray[np.float16],
    targets: Sequence[Target],
    region_maps: RegionMaps,
    ages: NDArray[np.uint8],
) -> EnergyTerms:
    """The terms of `futures` (F, steps+1, M, M) of a forecast made at frame t: step n against frame t+n.

    `targets`, `region_maps` and `ages` as of `counting.count_forecast`.
    """
    shape = len(targets), len(ENERGY_STRATA)
    terms = EnergyTerms(np.zeros(shape, np.int64), *np.zeros((2, *shape)))
    number: type[np.floating] = np.float32 if futures.dtype == np.bool_ else np.float64  # sums of 0 and 1 are exact
    for n, target in enumerate(targets):
        group = _GROUP_OF[cell_regions(target, region_maps, ages).ravel()]
        came = target.state.reshape(1, -1) == SEEN_OCCUPIED
        vectors: NDArray[Any] = np.concatenate([futures[:, n].reshape(len(futures), -1), came]).astype(number)
        products, cells = np.zeros((len(_GROUPS), *[len(vectors)] * 2)), np.bincount(group, minlength=len(_GROUPS))
        for g in np.flatnonzero(_GROUPS.any(axis=1)):
            own = vectors.take(np.flatnonzero(group == g), axis=1)
            products[g] = own @ own.T
        for k, of_groups in enumerate(_GROUPS.T):
            if counted := cells[of_groups].sum():
                terms.forecasts[n, k] = 1
                terms.distance[n, k], terms.spread[n, k] = distance_and_spread(products[of_groups].sum(axis=0), counted)
    return terms


def distance_and_spread(products: NDArray[np.float64], cells: int) -> tuple[float, float]:
    """The two terms of the score, of the scalar products (F+1, F+1) of F futures and, last, what came, over `cells`.

    A distance is the root of the mean squared difference over the cells: the Euclidean one over the root of their
    number.
    """
    squares = products.diagonal()
    distances = np.sqrt(np.maximum(squares[:, None] + squares - 2.0 * products, 0.0) / cells)
    count = len(products) - 1
    apart = distances[:-1, :-1][~np.eye(count, dtype=np.bool_)]
    return float(distances[-1, :-1].mean()), float(apart.mean() / 2)
