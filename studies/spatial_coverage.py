"""Coverage of the intervals and paired differences of the fractions skill score and beam errors, on drawn recordings.

`python -m studies.spatial_coverage` (two minutes; `--out docs/results/statistics.json` keeps the table). Recordings
differ in traffic, in how far forecasts are off, and in the share of beams that hit something that was not forecast; two
equally good trackers forecast them. Aim: the intervals cover 93 to 97 % at 20 units.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from gridtrack.evaluation.results.columns import BEAM_ERROR_EDGES_M
from gridtrack.evaluation.scores.neighbourhoods import SCALES
from gridtrack.evaluation.statistics.spatial_scores import (
    beam_ratios,
    beam_scores,
    neighbourhood_ratios,
    neighbourhood_scores,
    spatial_differences,
)

from studies.support.coverage import DrawnSet, covered, print_coverage, skills_of_two

UNITS = 20
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


def neighbourhood_sums(rng: np.random.Generator, number: NDArray[np.int64], off: NDArray[np.float64]) -> np.ndarray:
    """Sums (U, 1, 1, C) of recordings with a `number` of lone cells, far apart, each forecast `off` cells away.

    `off` (U,) is a standard deviation.
    """
    sums = np.zeros((len(number), 1, 1, 2 * len(SCALES) + 1))
    for unit, cells in enumerate(number):
        apart = np.abs(np.rint(off[unit] * rng.standard_normal((cells, 2))))
        for w, scale in enumerate(SCALES):
            common = np.maximum(scale - apart, 0.0).prod(axis=1).sum()
            sums[unit, 0, 0, [w, len(SCALES) + w]] = 2 * common / scale**4, 2 * cells / scale**2
        sums[unit, 0, 0, -1] = 2 * cells - (apart == 0).all(axis=1).sum()
    return sums


def beam_sums(
    rng: np.random.Generator, number: NDArray[np.int64], missed: NDArray[np.float64]
) -> tuple[np.ndarray, ...]:
    """Late and early sums (U, 1, 1) and counts (U, 1, 1, B) of a `number` of beams.

    The errors are of centimetres, and of metres where missed.
    """
    late, early = np.zeros((2, len(number), 1, 1))
    counts = np.zeros((len(number), 1, 1, len(BEAM_ERROR_EDGES_M) - 1), np.int64)
    for unit, beams in enumerate(number):
        error = 0.05 * rng.standard_normal(beams)
        behind = rng.random(beams) < missed[unit]
        error[behind] = rng.exponential(2.0, behind.sum())
        late[unit], early[unit] = np.maximum(error, 0.0).sum(), np.maximum(-error, 0.0).sum()
        counts[unit, 0, 0] = np.histogram(np.abs(error), BEAM_ERROR_EDGES_M)[0]
    return late, early, counts


def draw(rng: np.random.Generator, name: str, units: int) -> DrawnSet:
    """Scores of the first of two trackers on `units` recordings, and the differences of both.

    The recordings have the same cells and beams for both, and are hard for both, less for one of them.
    """
    off, missed, unlike = (SETTINGS[name][key] for key in ("off", "missed", "unlike"))
    traffic = np.exp(unlike * rng.standard_normal(units))
    cells, beams = rng.poisson(CELLS * traffic), rng.poisson(BEAMS * traffic)
    sides = [
        (
            neighbourhood_sums(rng, cells, off * np.exp(unlike * harder)),
            beam_sums(rng, beams, expit(logit(missed) + unlike * harder)),
        )
        for harder in skills_of_two(rng, units)
    ]
    (own, own_beams), _ = sides
    scores = {score: ends for score, *ends in (*neighbourhood_scores(own), *beam_scores(*own_beams))}
    ratios = [
        neighbourhood_ratios(sums) | beam_ratios(late, early, counts.sum(axis=-1).astype(np.float64))
        for sums, (late, early, counts) in sides
    ]
    gaps = spatial_differences(*ratios)
    return DrawnSet(
        {score: tuple(float(end[0, 0]) for end in scores[score]) for score in SHOWN},
        {score: gaps[score].at(0).at(0) for score in SHOWN if score in gaps},
    )


def rows(rng: np.random.Generator, repetitions: int) -> list[list[str]]:
    """A row for each setting and score."""
    return [
        [name, score, *texts]
        for name in SETTINGS
        for score, texts in covered(partial(draw, rng, name), UNITS, repetitions).items()
    ]


def main() -> None:
    print_coverage(
        __doc__,
        "coverage of spatial scores",
        "python -m studies.spatial_coverage",
        ["setting", "score", "value"],
        rows,
    )


if __name__ == "__main__":
    main()
