"""Coverage of the intervals of the fractions skill score and of beam errors, on drawn recordings.

`python -m studies.spatial_coverage` (a minute). Recordings differ in traffic, in how far forecasts are off, and in the
share of beams that hit something that was not forecast. Aim: the intervals cover 93 to 97 % at 20 units.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from gridtrack.evaluation.results.columns import BEAM_ERROR_EDGES_M, SCALES
from gridtrack.evaluation.statistics.spatial_scores import beam_scores, neighbourhood_scores

from studies.support.results_file import measured_table, write_table

UNITS, MANY_UNITS = 20, 4000
CELLS, BEAMS = 100.0, 400.0
"""Means of the lone occupied cells, and of the beams, of a recording."""
SETTINGS = {
    "recordings alike": {"off": 2.0, "missed": 0.2, "unlike": 0.1},
    "recordings unlike": {"off": 2.0, "missed": 0.2, "unlike": 0.5},
    "recordings very unlike": {"off": 2.0, "missed": 0.2, "unlike": 1.0},
    "far off": {"off": 6.0, "missed": 0.4, "unlike": 0.5},
    "half of the beams missed": {"off": 0.7, "missed": 0.5, "unlike": 0.5},
}
SHOWN = ("fss_1", "fss_5", "fss_9", "soft_iou", "beam_error", "beam_error_median", "beam_bias")


def neighbourhood_sums(rng: np.random.Generator, traffic: NDArray[np.float64], off: NDArray[np.float64]) -> np.ndarray:
    """Sums (U, 1, 1, C) of recordings of lone cells, far apart, each forecast `off` cells away (standard deviation)."""
    sums = np.zeros((len(traffic), 1, 1, 2 * len(SCALES) + 1))
    for unit, cells in enumerate(rng.poisson(CELLS * traffic)):
        apart = np.abs(np.rint(off[unit] * rng.standard_normal((cells, 2))))
        for w, scale in enumerate(SCALES):
            common = np.maximum(scale - apart, 0.0).prod(axis=1).sum()
            sums[unit, 0, 0, [w, len(SCALES) + w]] = 2 * common / scale**4, 2 * cells / scale**2
        sums[unit, 0, 0, -1] = 2 * cells - (apart == 0).all(axis=1).sum()
    return sums


def beam_sums(
    rng: np.random.Generator, traffic: NDArray[np.float64], missed: NDArray[np.float64]
) -> tuple[np.ndarray, ...]:
    """Late and early sums (U, 1, 1) and counts (U, 1, 1, B): errors of centimetres, and of metres where missed."""
    late, early = np.zeros((2, len(traffic), 1, 1))
    counts = np.zeros((len(traffic), 1, 1, len(BEAM_ERROR_EDGES_M) - 1), np.int64)
    for unit, beams in enumerate(rng.poisson(BEAMS * traffic)):
        error = 0.05 * rng.standard_normal(beams)
        behind = rng.random(beams) < missed[unit]
        error[behind] = rng.exponential(2.0, behind.sum())
        late[unit], early[unit] = np.maximum(error, 0.0).sum(), np.maximum(-error, 0.0).sum()
        counts[unit, 0, 0] = np.histogram(np.abs(error), BEAM_ERROR_EDGES_M)[0]
    return late, early, counts


def drawn_scores(
    rng: np.random.Generator, units: int, off: float, missed: float, unlike: float
) -> dict[str, list[float]]:
    """Value, low and high end of every score of `units` recordings."""
    traffic, hard = np.exp(unlike * rng.standard_normal(units)), unlike * rng.standard_normal(units)
    found = [
        *neighbourhood_scores(neighbourhood_sums(rng, traffic, off * np.exp(hard))),
        *beam_scores(*beam_sums(rng, traffic, expit(logit(missed) + hard))),
    ]
    return {name: [float(value[0, 0]) for value in values] for name, *values in found}


def coverage_row(rng: np.random.Generator, name: str, repetitions: int) -> list[str]:
    """For each score its value over many recordings, and the share of intervals that contain it."""
    truth = drawn_scores(rng, MANY_UNITS, **SETTINGS[name])
    inside = dict.fromkeys(SHOWN, 0)
    for _ in range(repetitions):
        drawn = drawn_scores(rng, UNITS, **SETTINGS[name])
        for score in SHOWN:
            inside[score] += drawn[score][1] <= truth[score][0] <= drawn[score][2]
    return [name, *(f"{100 * inside[score] / repetitions:.1f} ({truth[score][0]:.2f})" for score in SHOWN)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--repetitions", type=int, default=500, help="simulated sets of recordings for each setting")
    parser.add_argument("--out", type=Path, help="results file, such as docs/results/statistics.json")
    arguments = parser.parse_args()
    rng = np.random.default_rng(0)
    rows = [coverage_row(rng, name, arguments.repetitions) for name in SETTINGS]
    table = measured_table(["setting", *SHOWN], rows)
    print(table.markdown())
    write_table(arguments.out, "coverage of spatial scores", table, "python -m studies.spatial_coverage")


if __name__ == "__main__":
    main()
