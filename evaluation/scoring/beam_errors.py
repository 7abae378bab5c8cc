"""Beam errors: where a forecast expects the beams of the observed frame to end, less where they did, in metres.

A beam of frame t+n is followed from its sensor through the forecast for step n. It returns from the first cell that is
occupied, so it reaches a cell with the product of the probabilities that those before are free, and the expected
range is the mean over the cells. Only beams that ended in the window count. After Khurana et al., "Point cloud
forecasting as a proxy for 4D occupancy forecasting" (CVPR 2023), who evaluate forecasts by such expected ranges.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.common.raycast import clip
from gridtrack.evaluation.results.columns import BEAM_ERROR_BINS, BEAM_ERROR_EDGES_M
from gridtrack.evaluation.scoring.returned_beams import ReturnedBeams
from gridtrack.evaluation.scoring.strata import RANGES, REGIONS, STRATA, STRATA_WITH_TRUTH, SUMS_OF_REGIONS, RegionMaps
from gridtrack.evaluation.scoring.target import Target

BEAM_STRATA = STRATA
"""The strata that have beam errors: a beam counts in those of the cell that it ended in, which is visible."""
LEAST_REACHED = 1e-6
"""A beam that goes on with less than this probability is followed no further."""


@dataclass(frozen=True, slots=True)
class BeamErrors:
    """Sums over beams, per step S = steps+1 and stratum K of BEAM_STRATA.

    `late`, `early` (S, K) float64: sums, metres, of the errors of beams that are expected to end behind what they hit,
    and before it; `counts` (S, K, B) int64: beams by the size of their error, in bins of BEAM_ERROR_EDGES_M.
    """

    late: NDArray[np.float64]
    early: NDArray[np.float64]
    counts: NDArray[np.int64]


def beam_errors(
    occupancy: NDArray[np.float32], targets: Sequence[Target], region_maps: RegionMaps, cell_m: float
) -> BeamErrors:
    """The errors of a forecast made at frame t: step n along the beams of frame t+n.

    `occupancy` (steps+1, M, M) float32 in [0, 1]; `targets` t..t+steps; cells have sides of `cell_m` metres.
    """
    sums = SUMS_OF_REGIONS[[STRATA_WITH_TRUTH.index(name) for name in BEAM_STRATA]]
    shape = len(targets), len(BEAM_STRATA)
    late, early, counts = np.zeros(shape), np.zeros(shape), np.zeros((*shape, BEAM_ERROR_BINS), np.int64)
    for n, target in enumerate(targets):
        cells = target.beams.cells
        region = region_maps.visible.reshape(-1)[cells].astype(np.int64) + RANGES * target.motion.reshape(-1)[cells]
        error_m = cell_m * (expected_ranges(occupancy[n], target.beams) - target.beams.ranges)
        late[n] = sums @ np.bincount(region, np.maximum(error_m, 0.0), REGIONS)
        early[n] = sums @ np.bincount(region, np.maximum(-error_m, 0.0), REGIONS)
        bins = np.searchsorted(BEAM_ERROR_EDGES_M[1:-1], np.abs(error_m), side="right")
        of_region = np.bincount(region * BEAM_ERROR_BINS + bins, minlength=REGIONS * BEAM_ERROR_BINS)
        counts[n] = sums @ of_region.reshape(REGIONS, BEAM_ERROR_BINS)
    return BeamErrors(late, early, counts)


def expected_ranges(occupancy: NDArray[np.float32], beams: ReturnedBeams) -> NDArray[np.float64]:
    """Expected range (N,), in cells, of each beam in a forecast (M, M) of the frame that it is of.

    A return from a cell is counted at the middle of the beam's way through it, and a beam that passes all cells where
    it leaves the window, or at the sensor's maximum range.
    """
    ranges: NDArray[np.float64] = np.empty(beams.ranges.size)
    _follow(np.ascontiguousarray(occupancy), beams.starts, beams.directions, beams.longest, ranges)
    return ranges


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _follow(occupancy, starts, directions, longest, ranges):  # type: ignore[no-untyped-def]
    """Follow each beam from cell to cell (Amanatides and Woo, 1987), and set its expected range."""
    size = occupancy.shape[0]
    for i in range(ranges.size):
        x0, y0, dx, dy = starts[i, 0], starts[i, 1], directions[i, 0], directions[i, 1]
        enter, leave = clip(x0, y0, dx * longest[i], dy * longest[i], size)
        at, end = enter * longest[i], leave * longest[i]
        column = min(max(int(np.floor(x0 + at * dx)), 0), size - 1)
        row = min(max(int(np.floor(y0 + at * dy)), 0), size - 1)
        step_x, step_y = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
        apart_x, apart_y = 1.0 / abs(dx), 1.0 / abs(dy)  # infinite along an axis
        next_x = (column + (dx > 0) - x0) / dx if dx != 0 else np.inf
        next_y = (row + (dy > 0) - y0) / dy if dy != 0 else np.inf
        reached, expected = 1.0, 0.0
        while at < end and 0 <= column < size and 0 <= row < size and reached > LEAST_REACHED:
            after = min(next_x, next_y, end)
            if after > at:  # not a cell that is only touched at a corner
                returned = reached * occupancy[row, column]
                expected += returned * 0.5 * (at + after)
                reached -= returned
                at = after
            if next_x < next_y:
                next_x += apart_x
                column += step_x
            else:
                next_y += apart_y
                row += step_y
        ranges[i] = expected + reached * end
