"""Speed of a comparison's statistics: intervals and paired differences of many trackers.

`python -m benchmarks.statistics` (some seconds). Aim: intervals and differences for 10 trackers x 21 steps x 8 strata
from 20 recordings in 10 s.
"""

from __future__ import annotations

import argparse

import numpy as np

from gridtrack.evaluation.scores.f1 import COUNTS
from gridtrack.evaluation.statistics.jackknife import holm, interval
from gridtrack.reports import differences

from benchmarks.timing import median_ms

SCORES = ("f1", "precision", "recall", "brier", "nll")


def main() -> None:
    argparse.ArgumentParser(description=__doc__.partition("\n")[0]).parse_args()
    trackers = np.random.default_rng(0).poisson(50.0, (10, 20, 21, 8, len(COUNTS))).astype(np.float64)

    def statistics_of_all() -> None:
        for counts in trackers:
            for score in SCORES:
                interval(counts, score)
        gaps = [differences(counts, trackers[0]) for counts in trackers[1:]]
        holm(np.concatenate([gap.p[[4, 8, 20], :2].ravel() for gap in gaps]))

    ms = median_ms(statistics_of_all, 3)
    print(
        f"10 trackers x 21 steps x 8 strata from 20 recordings: {len(SCORES)} intervals and the differences {ms:.0f} ms"
    )


if __name__ == "__main__":
    main()
