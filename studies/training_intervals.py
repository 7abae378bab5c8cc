"""Coverage of the intervals of differences between trackers with several trainings each.

`python -m studies.training_intervals` (a minute; `--out docs/results/statistics.json` keeps the table). Drawn are two
trackers without a difference, on 20 recordings: each recording has its own difficulty, each tracker its own recordings
that it finds hard, each training its own level, and its own error on each recording. The rows of a tracker, its strata
and horizons, have a part of each deviation in common, or all of it: then nine rows tell no more of the spread between
trainings than one. Aim: 93 to 97 %.
"""

from __future__ import annotations

import argparse
from itertools import product
from pathlib import Path

import numpy as np

from gridtrack.evaluation.statistics.trainings import Trainings, training_differences

from studies.support.results_file import measured_table, write_table

UNITS, ROWS, OCCUPIED = 20, 9, 1000.0
DIFFICULTY, OF_TRACKER, OF_TRAINING_AND_UNIT = 0.04, 0.01, 0.005
"""Standard deviations of recall: of a recording, of a tracker on a recording, and of one training of it there."""
LEVELS = (0.0, 0.002, 0.005, 0.01)
"""Standard deviations of the level of a training; the standard error over 20 recordings alone is about 0.004."""
TRAININGS = (3, 5)
IN_COMMON = (0.64, 1.0)
"""The share of each deviation's variance that the rows of a tracker have in common."""


def drawn(
    rng: np.random.Generator, trainings: int, level: float, difficulty: np.ndarray, in_common: float, *, learned: bool
) -> Trainings:
    """One tracker: F1 (K, U, R) follows from recall without false alarms."""
    recall = 0.6 + difficulty
    for scale, shape in (
        (level, (trainings, 1)),
        (OF_TRACKER, (1, UNITS)),
        (OF_TRAINING_AND_UNIT, (trainings, UNITS)),
    ):
        shared, own = rng.standard_normal((*shape, 1)), rng.standard_normal((*shape, ROWS))
        recall = recall + scale * (np.sqrt(in_common) * shared + np.sqrt(1 - in_common) * own)
    tp = OCCUPIED * recall
    return Trainings(np.stack([2 * tp, tp + OCCUPIED], axis=-1), learned)


def coverage(trainings: int, level: float, draws: int, in_common: float, *, learned_reference: bool) -> float:
    """Share of intervals that hold 0; one training is judged by the variance over recordings alone."""
    rng, held = np.random.default_rng(trainings), 0
    for _ in range(draws):
        difficulty = DIFFICULTY * rng.standard_normal((1, UNITS, 1))
        own = drawn(rng, trainings, level, difficulty, in_common, learned=trainings > 1)
        of_reference = (trainings, level) if learned_reference else (1, 0.0)
        reference = drawn(rng, *of_reference, difficulty, in_common, learned=learned_reference and trainings > 1)
        found = training_differences(own, reference)
        held += int(((found.low <= 0) & (found.high >= 0)).sum())
    return held / (draws * ROWS)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--draws", type=int, default=1000)
    parser.add_argument("--out", type=Path, help="results file that keeps the table")
    given = parser.parse_args()
    columns = ["reference", "rows in common", "spread of the level", "over recordings alone"]
    columns += [f"{count} trainings" for count in TRAININGS]
    rows = []
    for learned, in_common, level in product((True, False), IN_COMMON, LEVELS):
        covered = [coverage(k, level, given.draws, in_common, learned_reference=learned) for k in (1, *TRAININGS)]
        reference = "with trainings" if learned else "without weights"
        rows.append([reference, f"{in_common:.0%}", f"{level:g}", *(f"{share:.1%}" for share in covered)])
        print(rows[-1], flush=True)
    write_table(given.out, "trainings", measured_table(columns, rows), "python -m studies.training_intervals")


if __name__ == "__main__":
    main()
