"""How often two trackers without a difference are told apart where one of them is better on large recordings.

`python -m studies.unlike_sizes` (a minute; `--out docs/results/statistics.json` keeps the table). Drawn are two
trackers whose F1 over all recordings that could be sampled is the same: one finds more in large recordings and less in
small ones. Where sizes have a long tail, a sample lacks the largest recordings, which decide. Nominal: 5 %.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy.optimize import brentq
from scipy.special import expit

from gridtrack.evaluation.scores.f1 import COUNTS
from gridtrack.evaluation.statistics.jackknife import degrees_of_freedom, pooled, ratio_sums
from gridtrack.reports import differences

from studies.support.results_file import measured_table, write_table

SPREADS = (0.0, 0.5, 1.0, 1.5)
"""Standard deviations of the logarithm of the number of occupied cells in a recording."""
UNITS = (20, 60)
SLOPE = 0.3
"""By how much the log odds of the recall of the one tracker grow with the logarithm of the size."""
CELLS, DIFFICULTY, OF_TRACKER, FALSE_ALARMS = 300.0, 0.5, 0.3, 0.4


def drawn(rng: np.random.Generator, shape: tuple[int, ...], spread: float, level: float) -> tuple[np.ndarray, ...]:
    """Counts (U, R, C) of two trackers on the same recordings; `level` moves the recall of the first everywhere."""
    log_size = spread * rng.standard_normal(shape)
    occupied = rng.poisson(CELLS * np.exp(log_size))
    difficulty = DIFFICULTY * rng.standard_normal(shape)
    found = []
    for merit in (level + SLOPE * log_size, np.zeros(shape)):
        recall = expit(difficulty + merit + OF_TRACKER * rng.standard_normal(shape))
        counts = np.zeros((*shape, len(COUNTS)))
        counts[..., COUNTS.index("tp")] = rng.binomial(occupied, recall)
        counts[..., COUNTS.index("fn")] = occupied - counts[..., COUNTS.index("tp")]
        counts[..., COUNTS.index("fp")] = rng.poisson(FALSE_ALARMS * CELLS * np.exp(log_size))
        found.append(counts)
    return tuple(found)


def equal_level(spread: float) -> float:
    """The level at which both trackers have the same F1 over a great many recordings."""

    def gap(level: float) -> float:
        one, other = drawn(np.random.default_rng(1), (200_000,), spread, level)
        return float(pooled(one, "f1") - pooled(other, "f1"))

    return float(brentq(gap, -3.0, 3.0, xtol=1e-3))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--draws", type=int, default=4000)
    parser.add_argument("--out", type=Path, help="results file that keeps the table")
    given = parser.parse_args()
    columns = ["spread of log size"]
    columns += [f"{units} recordings: {what}" for units in UNITS for what in ("effective", "told apart, %")]
    rows = []
    for spread in SPREADS:
        level, cells = equal_level(spread), []
        for units in UNITS:
            one, other = drawn(np.random.default_rng(2), (units, given.draws), spread, level)
            freedom = degrees_of_freedom(ratio_sums(one, "f1")[1], ratio_sums(other, "f1")[1])
            told = differences(one, other).p < 0.05
            cells += [f"{np.median(freedom) + 1:.0f}", f"{100 * np.mean(told):.1f}"]
        rows.append([f"{spread:g}", *cells])
        print(rows[-1], flush=True)
    write_table(given.out, "unlike sizes", measured_table(columns, rows), "python -m studies.unlike_sizes")


if __name__ == "__main__":
    main()
