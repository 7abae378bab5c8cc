"""Beam error: where a forecast expects the beams of the observed frame to end, less where they ended, in metres.

A beam of frame t+n is followed from its sensor to the edge of the window through the forecast for step n. It returns
from the first cell that is occupied, so it reaches a cell with the product of the probabilities that the cells before
it are free, and the expected range is the mean over the cells. Every beam counts, also one that left the window: on
beams that ended in a stratum alone, a forecast that calls everything occupied has a small error. After Khurana et al.,
"Point cloud forecasting as a proxy for 4D occupancy forecasting" (CVPR 2023), who evaluate such expected ranges.
"""

from __future__ import annotations

from collections.abc import Mapping

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import RESOLUTION_CELLS
from gridtrack.common.raycast import clip, first_cell
from gridtrack.evaluation.referee.referee import ScoredForecast
from gridtrack.evaluation.referee.targets import BeamPaths
from gridtrack.evaluation.scores.definition import (
    Floats,
    Measure,
    Output,
    Ratio,
    ScoreDefinition,
    Sums,
    TrialFacts,
    block,
    divided,
)

EDGES_M = np.concatenate([[0.0], 2.0 ** (np.arange(-7 * 8, 12 * 8 + 1) / 8), [np.inf]])
"""Edges of the bins of the size of a beam error, metres: eight to each octave from 8 mm to 4 km, for its median."""
BINS = len(EDGES_M) - 1
LEAST_REACHED = 1e-6
"""A beam that goes on with less than this probability is followed no further."""


def _count(forecast: ScoredForecast, facts: TrialFacts, memory: None) -> Floats:
    """Sums (S, 1, 2 + B) over beams.

    Metres by which beams are expected to end behind their returns (late), and before them (early), and the number of
    beams by the size of the error.
    """
    found = np.zeros((len(forecast.targets), 1, 2 + BINS))
    steps_of: dict[BeamPaths, list[int]] = {}
    for n, target in enumerate(forecast.targets):
        steps_of.setdefault(target.beams.paths, []).append(n)
    for paths, steps in steps_of.items():
        ranges = np.stack([forecast.targets[n].beams.ranges for n in steps])
        errors_m = facts.cell_m * (expected_ranges(forecast.occupancy[steps], paths, ranges) - ranges)
        for n, error_m in zip(steps, errors_m, strict=True):
            known_m = error_m[~np.isnan(error_m)]
            found[n, 0, 0] = np.maximum(known_m, 0.0).sum()
            found[n, 0, 1] = np.maximum(-known_m, 0.0).sum()
            bins = np.searchsorted(EDGES_M[1:-1], np.abs(known_m), side="right")
            found[n, 0, 2:] = np.bincount(bins, minlength=BINS)
    return found


def _value(sums: Sums) -> Mapping[str, Ratio | Measure]:
    late_m, early_m, by_size = sums["late"], sums["early"], sums.block("beams")
    beams = by_size.sum(axis=-1)
    return {
        "mean": Ratio(late_m + early_m, beams),
        "median": Measure(median_size(by_size), beams),
        "bias": Measure(divided(late_m, beams) - divided(early_m, beams), beams),
    }


def median_size(counts: Floats) -> Floats:
    """Median (...), metres, of the beam errors counted by size (..., B): as if they lay evenly within their bin."""
    number = counts.sum(axis=-1)
    up_to = counts.cumsum(axis=-1)
    bin_ = (2 * up_to >= number[..., None]).argmax(axis=-1)
    inside = np.take_along_axis(counts, bin_[..., None], axis=-1)[..., 0]
    before = np.take_along_axis(up_to, bin_[..., None], axis=-1)[..., 0] - inside
    low, high = EDGES_M[bin_], EDGES_M[:-1][np.minimum(bin_ + 1, BINS - 1)]
    median: Floats = low + (high - low) * np.nan_to_num(divided(number / 2 - before, inside))
    return np.where(number > 0, median, np.nan)


def expected_ranges(
    occupancy: NDArray[np.float32], paths: BeamPaths, ranges: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Expected range (S, N), in cells, of each beam in the forecasts (S, M, M) of the frames that it is of.

    A return from a cell is counted at the middle of the beam's way through it, and a beam that passes all cells at its
    end: where it leaves the window, or at the sensor's maximum range. A beam without `ranges` (S, N) is not followed.
    """
    expected = np.full(ranges.shape, np.nan)
    followed = ~np.isnan(ranges).all(axis=0)
    of_cells = np.ascontiguousarray(occupancy.transpose(1, 2, 0))
    _follow(of_cells, paths.starts, paths.directions, paths.ends, followed, expected)
    return expected


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _follow(occupancy, starts, directions, ends, followed, ranges):  # type: ignore[no-untyped-def]
    """Follow each beam from cell to cell (Amanatides and Woo, 1987), and set its expected ranges (S, N).

    All forecasts (M, M, S) at once: the way of a beam is the same in each, and the loop over them is a vector loop.
    """
    size, steps = occupancy.shape[0], occupancy.shape[2]
    reached, expected = np.empty((2, steps))
    for i in range(ends.size):
        if not followed[i]:
            continue
        dx, dy, end = directions[i, 0], directions[i, 1], ends[i]
        x0, y0 = starts[i, 0], starts[i, 1]
        enter, _ = clip(x0, y0, dx * end, dy * end, size)
        at = enter * end
        column, row = first_cell(x0 + at * dx, dx, size), first_cell(y0 + at * dy, dy, size)
        step_x, step_y = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
        apart_x, apart_y = 1.0 / abs(dx), 1.0 / abs(dy)  # infinite along an axis
        next_x = (column + (dx > 0) - x0) / dx if dx != 0 else np.inf
        next_y = (row + (dy > 0) - y0) / dy if dy != 0 else np.inf
        reached[:], expected[:], going = 1.0, 0.0, steps
        while at < end and 0 <= column < size and 0 <= row < size and going:
            after = min(next_x, next_y, end)
            if after > at + RESOLUTION_CELLS:  # not a cell that is only touched at a corner
                middle, of_cell, going = 0.5 * (at + after), occupancy[row, column], 0
                for s in range(steps):
                    returned = reached[s] * of_cell[s] if reached[s] > LEAST_REACHED else 0.0
                    expected[s] += returned * middle
                    reached[s] -= returned
                    going += reached[s] > LEAST_REACHED
                at = after
            if next_x < next_y:
                next_x += apart_x
                column += step_x
            else:
                next_y += apart_y
                row += step_y
        for s in range(steps):
            ranges[s, i] = expected[s] + reached[s] * end


BEAM_ERROR = ScoreDefinition(
    name="beam_error",
    title="Beam error",
    position=80,
    outputs=(
        Output("mean", "Beam error", unit="m", better="lower", scale="log", tested=True),
        Output("median", "Median beam error", unit="m", better="lower", scale="log"),
        Output("bias", "Beam bias", unit="m", scale="linear"),
    ),
    about="Mean distance, metres, from the end of a beam of the observed frame to the end that the forecast expects,"
    " over all beams, from the sensor to the edge of the window. The bias is above 0 where an obstacle was not"
    " forecast, and below 0 where a forecast obstacle is not there. Small probabilities add up along a beam, so"
    " calibrated cells can have a large error. Khurana et al., 2023.",
    strata=lambda facts: ("visible",),
    parts=lambda facts: ("late", "early", *block("beams", BINS)),
    count=_count,
    value=_value,
)
