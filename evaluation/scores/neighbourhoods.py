"""Sums over neighbourhoods of cells, in one pass: for scores that forgive a forecast a few cells.

The fractions skill score (Roberts and Lean, Monthly Weather Review 136, 2008) compares shares: of the square of n x n
cells about a cell, P is the mean probability and O the share of occupied cells. Only cells of the stratum count, in
the means and as centres, so cells that no beam reached, and cells outside the window, add nothing and take nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.referee.referee import ScoredForecast
from gridtrack.evaluation.referee.strata import OCCLUDED, RegionMaps
from gridtrack.evaluation.referee.targets import Target, cell_regions, members

NEIGHBOURHOOD_STRATA = ("visible", "dynamic", "in-motion", OCCLUDED)
"""The strata that have these sums: the headline's, and with truth the hidden cells."""
SCALES = (1, 3, 5, 9)
"""Sides, in cells, of the neighbourhoods of the fractions skill score."""
_MARGIN = max(SCALES) // 2
_UNITS = np.float32(1 << 24)
"""Probabilities are multiples of 1 / _UNITS: the sum over a neighbourhood of the largest scale fits 32 bits."""
_MEMBER_BITS = 8
"""The marks of a neighbourhood are added in one number: members in these bits, occupied ones above them."""
_MEMBERS = (1 << _MEMBER_BITS) - 1


@dataclass(frozen=True, slots=True)
class NeighbourhoodSums:
    """Sums of one forecast, per step S = steps+1, stratum K and scale W, over the cells as centres of neighbourhoods.

    `agreement` (S, K, W) float64: sum of 2 P O; `squares` (S, K, W): sum of P^2 + O^2, so that their ratio is
    1 - sum (P - O)^2 / (sum P^2 + sum O^2); `soft_union` (S, K): sum over cells of p + o - p o. `strata`: the K names.
    """

    agreement: NDArray[np.float64]
    squares: NDArray[np.float64]
    soft_union: NDArray[np.float64]
    strata: tuple[str, ...]


def neighbourhood_strata(strata: Sequence[str]) -> tuple[str, ...]:
    """Those of `strata` that have sums over neighbourhoods."""
    return tuple(name for name in NEIGHBOURHOOD_STRATA if name in strata)


def neighbourhoods_of(forecast: ScoredForecast) -> NeighbourhoodSums:
    """The sums of a forecast."""
    return sum_neighbourhoods(forecast.occupancy, forecast.targets, forecast.region_maps, forecast.ages)


def sum_neighbourhoods(
    occupancy: NDArray[np.float32], targets: Sequence[Target], region_maps: RegionMaps, ages: NDArray[np.uint8]
) -> NeighbourhoodSums:
    """The sums of a forecast made at frame t: step n against frame t+n; arguments as of `cells.count_cells`."""
    strata = neighbourhood_strata(region_maps.strata)
    member_of = members(strata)
    found = np.zeros((2, len(targets), len(strata), len(SCALES)))
    soft_union = np.zeros((len(targets), len(strata)))
    size = len(region_maps.visible)
    marked = np.zeros((2, size + 2 * _MARGIN, size + 2 * _MARGIN), np.int32)
    for n, target in enumerate(targets):
        region = cell_regions(target, region_maps, ages)
        for k in range(len(strata)):
            first, last, *sums = _mark(occupancy[n], target.state, region, member_of[k], marked)
            found[0, n, k, 0], found[1, n, k, 0], soft_union[n, k] = sums
            for w, add_products in enumerate(_ADDERS if first <= last else (), start=1):
                found[:, n, k, w] = add_products(marked, first, last)
    return NeighbourhoodSums(found[0], found[1], soft_union, strata)


@numba.njit(cache=True, nogil=True)
def _mark(probability, state, region, member_of, marked):  # type: ignore[no-untyped-def]
    """Set `marked` (2, M + margins, M + margins) int32: probabilities of members, in 1 / _UNITS, and their marks.

    Sums of these integers are exact. Returns the first and the last row with a member, M and -1 if there is none, and
    the sums over members of 2 p o, p^2 + o^2 and p + o - p o.
    """
    first, last = probability.shape[0], -1
    agreement, squares, union = 0.0, 0.0, 0.0
    for r in range(probability.shape[0]):
        for c in range(probability.shape[1]):
            if not member_of[region[r, c]]:
                marked[0, r + _MARGIN, c + _MARGIN] = 0
                marked[1, r + _MARGIN, c + _MARGIN] = 0
                continue
            first, last = min(first, r), r
            p, o = np.float64(probability[r, c]), np.int32(state[r, c] & 1)
            marked[0, r + _MARGIN, c + _MARGIN] = np.int32(p * _UNITS + np.float32(0.5))
            marked[1, r + _MARGIN, c + _MARGIN] = (o << _MEMBER_BITS) + 1
            agreement += 2 * p * o
            squares += p * p + o
            union += p + (1 - p) * o
    return first, last, agreement, squares, union


def _adder(scale: int) -> Callable[..., tuple[float, float]]:
    """A kernel that adds up the products of neighbourhoods of one scale: its loop over a row becomes a vector loop."""
    half = scale // 2
    first = _MARGIN - half

    @numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "nsz", "contract"})
    def add_products(marked, first_row, last_row):  # type: ignore[no-untyped-def]
        """Sums of 2 P O and P^2 + O^2 of `marked` (2, M + margins, M + margins), at every member, in these rows."""
        width = marked.shape[2]
        size = width - 2 * _MARGIN
        probabilities, marks = np.zeros((2, width), np.int32)
        both_of_all, each_of_all = np.float64(0.0), np.float64(0.0)
        for r in range(first_row + first, first_row + first + 2 * half):
            for c in range(width):
                probabilities[c] += marked[0, r, c]
                marks[c] += marked[1, r, c]
        for r in range(first_row, last_row + 1):
            for c in range(width):
                probabilities[c] += marked[0, r + _MARGIN + half, c]
                marks[c] += marked[1, r + _MARGIN + half, c]
            both, each = np.float32(0.0), np.float32(0.0)
            for c in range(size):
                p_sum, mark_sum = np.int32(0), np.int32(0)
                for d in range(scale):
                    p_sum += probabilities[c + first + d]
                    mark_sum += marks[c + first + d]
                p = np.float32(p_sum) * np.float32(1.0 / _UNITS)
                o, cells = np.float32(mark_sum >> _MEMBER_BITS), np.float32(mark_sum & _MEMBERS)
                centre = np.float32(marked[1, r + _MARGIN, c + _MARGIN] & 1)
                weight = centre / max(cells * cells, np.float32(1.0))
                both += weight * (p * o)
                each += weight * (p * p + o * o)
            both_of_all += np.float64(both)
            each_of_all += np.float64(each)
            for c in range(width):
                probabilities[c] -= marked[0, r + first, c]
                marks[c] -= marked[1, r + first, c]
        return 2.0 * both_of_all, each_of_all

    kernel: Callable[..., tuple[float, float]] = add_products
    return kernel


_ADDERS = tuple(_adder(scale) for scale in SCALES[1:])
