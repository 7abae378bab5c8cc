"""Coverage of the interval of PR-AUC, and of its paired difference, on drawn histograms of recordings.

`python -m studies.pr_auc_coverage` (two minutes; `--out docs/results/statistics.json` keeps the table). Two equally
good trackers forecast the same recordings, which differ in difficulty and traffic. Aim: the interval covers 93 to 97 %
at 20 units in every setting.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from gridtrack.evaluation.scores.cells import PROBABILITY_BINS, PROBABILITY_EDGES
from gridtrack.evaluation.statistics.pr_auc import pr_auc_without_each

from studies.support.coverage import DrawnSet, covered, print_coverage, skills_of_two

CELLS = 3000
UNITS = (20, 60)
SETTINGS = {
    "recordings alike": {"rare": 0.02, "skill": 2.5, "unlike": 0.1},
    "recordings unlike": {"rare": 0.02, "skill": 2.5, "unlike": 0.5},
    "recordings very unlike": {"rare": 0.02, "skill": 2.5, "unlike": 1.0},
    "poor forecasts": {"rare": 0.02, "skill": 1.0, "unlike": 0.5},
    "good forecasts": {"rare": 0.05, "skill": 4.0, "unlike": 0.5},
    "positives rare": {"rare": 0.002, "skill": 2.5, "unlike": 0.5},
}

Histograms = tuple[NDArray[np.int64], NDArray[np.int64]]
"""Cells and occupied cells (U, 1, B) of units."""


def two_trackers(rng: np.random.Generator, units: int, rare: float, skill: float, unlike: float) -> list[Histograms]:
    """Two trackers whose score of a cell is normal, and higher where the cell is occupied: on average by `skill`.

    Each recording changes the skill of both trackers, and less that of one; `rare` is the share of occupied cells.
    """
    easier = skills_of_two(rng, units)
    occupied = np.minimum(rng.poisson(CELLS * rare * np.exp(unlike * rng.standard_normal(units))), CELLS)
    found = []
    for own in easier:
        shift = skill + unlike * own
        cells, positives = np.zeros((2, units, 1, PROBABILITY_BINS), np.int64)
        for unit, hits in enumerate(occupied):
            score = rng.standard_normal(CELLS)
            score[:hits] += shift[unit]
            p = expit(skill * score - skill**2 / 2 + logit(rare))
            bins = PROBABILITY_EDGES[1:-1].searchsorted(p, side="right")
            cells[unit, 0] = np.bincount(bins, minlength=PROBABILITY_BINS)
            positives[unit, 0] = np.bincount(bins[:hits], minlength=PROBABILITY_BINS)
        found.append((cells, positives))
    return found


def draw(rng: np.random.Generator, name: str, units: int) -> DrawnSet:
    """PR-AUC of the first of two trackers on `units` recordings, and the difference of both."""
    one, other = (pr_auc_without_each(*drawn) for drawn in two_trackers(rng, units, **SETTINGS[name]))
    low, high = one.interval()
    return DrawnSet({"PR-AUC": (one.value[0], low[0], high[0])}, {"PR-AUC": one.less(other).at(0)})


def rows(rng: np.random.Generator, repetitions: int) -> list[list[str]]:
    """A row for each setting and number of units."""
    return [
        [name, str(units), *covered(partial(draw, rng, name), units, repetitions)["PR-AUC"]]
        for name in SETTINGS
        for units in UNITS
    ]


def main() -> None:
    print_coverage(
        __doc__, "coverage of PR-AUC", "python -m studies.pr_auc_coverage", ["setting", "units", "PR-AUC"], rows
    )


if __name__ == "__main__":
    main()
