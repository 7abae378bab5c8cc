"""Coverage of the interval of PR-AUC, and of its paired difference, on drawn histograms of recordings.

`python -m studies.pr_auc_coverage` (two minutes). Two equally good trackers forecast the same recordings, which differ
in difficulty and traffic. Aim: the interval covers 93 to 97 % at 20 units in every setting.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from gridtrack.evaluation.results.columns import PROBABILITY_BINS, PROBABILITY_EDGES
from gridtrack.evaluation.scoring.metrics import area_under_precision_recall
from gridtrack.evaluation.statistics.pr_auc import pr_auc_without_each

from studies.support.results_file import measured_table, write_table

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
    shared = rng.standard_normal(units)
    occupied = np.minimum(rng.poisson(CELLS * rare * np.exp(unlike * rng.standard_normal(units))), CELLS)
    found = []
    for _ in range(2):
        shift = skill + unlike * (np.sqrt(0.8) * shared + np.sqrt(0.2) * rng.standard_normal(units))
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


def coverage_row(rng: np.random.Generator, name: str, units: int, repetitions: int) -> list[str]:
    """Shares of intervals that contain the truth, of those of differences that contain 0, and of p below 0.05."""
    (cells, positives), _ = two_trackers(rng, 4000, **SETTINGS[name])
    truth = float(area_under_precision_recall(cells.sum(axis=0), positives.sum(axis=0))[0])
    counted = np.zeros(3)
    for _ in range(repetitions):
        one, other = (pr_auc_without_each(*drawn) for drawn in two_trackers(rng, units, **SETTINGS[name]))
        (low, high), gap = one.interval(), one.less(other)
        counted += [low[0] <= truth <= high[0], gap.low[0] <= 0 <= gap.high[0], gap.p[0] < 0.05]
    return [name, str(units), f"{truth:.2f}", *(f"{100 * share:.1f}" for share in counted / repetitions)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--repetitions", type=int, default=300, help="simulated sets of recordings for each setting")
    parser.add_argument("--out", type=Path, help="results file, such as docs/results/statistics.json")
    arguments = parser.parse_args()
    rng = np.random.default_rng(0)
    rows = [coverage_row(rng, name, units, arguments.repetitions) for name in SETTINGS for units in UNITS]
    columns = ["setting", "units", "PR-AUC", "interval covers, %", "difference covers, %", "p < 0.05, %"]
    table = measured_table(columns, rows)
    print(table.markdown())
    write_table(arguments.out, "coverage of PR-AUC", table, "python -m studies.pr_auc_coverage")


if __name__ == "__main__":
    main()
