"""The energy score of sampled futures, against the cells that are visible when the step has come.

Gneiting and Raftery, Journal of the American Statistical Association 102 (2007), equation 22: the mean distance of the
futures from what came, less half their mean distance from each other. The second mean is over pairs of different
futures, so that the expected score does not depend on their number (Ferro, Quarterly Journal of the Royal
Meteorological Society 140, 2014).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.scoring.neighbourhoods import NO_REGION, cell_regions
from gridtrack.evaluation.scoring.strata import REGIONS, STRATA_WITH_TRUTH, SUMS_OF_REGIONS, RegionMaps
from gridtrack.evaluation.scoring.target import SEEN_OCCUPIED, Target

ENERGY_STRATA = ("visible", "dynamic", "in-motion")
"""The strata that have energy scores."""
_MEMBER_OF = np.zeros((len(ENERGY_STRATA), REGIONS + 1), np.bool_)
_MEMBER_OF[:, :NO_REGION] = SUMS_OF_REGIONS[[STRATA_WITH_TRUTH.index(name) for name in ENERGY_STRATA]]


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
    for n, target in enumerate(targets):
        regions = cell_regions(target, region_maps, ages).ravel()
        planes, came = futures[:, n].reshape(len(futures), -1), target.state.ravel() == SEEN_OCCUPIED
        for k, member_of in enumerate(_MEMBER_OF):
            cells = np.flatnonzero(member_of[regions])
            if cells.size:
                terms.forecasts[n, k] = 1
                own = planes[:, cells].astype(np.float64)
                terms.distance[n, k], terms.spread[n, k] = distance_and_spread(own, came[cells].astype(np.float64))
    return terms


def distance_and_spread(futures: NDArray[np.float64], came: NDArray[np.float64]) -> tuple[float, float]:
    """The two terms of the score of `futures` (F, N) against `came` (N,).

    A distance is the root of the mean squared difference over the N cells: the Euclidean one over the root of N.
    """
    distance = np.sqrt(((futures - came) ** 2).mean(axis=1)).mean()
    products = futures @ futures.T
    squares = products.diagonal()
    apart = np.sqrt(np.maximum(squares[:, None] + squares - 2.0 * products, 0.0) / came.size)
    count = len(futures)
    return float(distance), float(apart[~np.eye(count, dtype=np.bool_)].sum() / (2 * count * (count - 1)))
