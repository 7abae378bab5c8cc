"""Coverage of the intervals of differences between trackers with several trainings each.

`python -m studies.training_intervals` (one minute; `--out docs/results/statistics.json` keeps the table). Drawn are two
trackers without a difference, on 20 recordings: each recording has its own difficulty, each tracker its own recordings
that it finds hard, each training its own level, and its own error on each recording. Aim: 93 to 97 %.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from gridtrack.evaluation.statistics.training_differences import Trainings, training_differences

from studies.support.results_file import measured_table, write_table

UNITS, ROWS, OCCUPIED = 20, 9, 1000.0
DIFFICULTY, OF_TRACKER, OF_TRAINING_AND_UNIT = 0.04, 0.01, 0.005
"""Standard deviations of recall: of a recording, of a tracker on a recording, and of one training of it there."""
LEVELS = (0.0, 0.002, 0.005, 0.01)
"""Standard deviations of the level of a training; the standard error over 20 recordings alone is about 0.004."""
TRAININGS = (2, 3, 5)


def drawn(rng: np.random.Generator, trainings: int, level: float, difficulty: np.ndarray) -> Trainings:
    """One tracker: F1 (K, U, R) follows from recall without false alarms. The rows share a part of each deviation, as
    strata and horizons do."""
    recall = 0.6 + difficulty
    for scale, shape in (
        (level, (trainings, 1)),
        (OF_TRACKER, (1, UNITS)),
        (OF_TRAINING_AND_UNIT, (trainings, UNITS)),
    ):
        shared, own = rng.standard_normal((*shape, 1)), rng.standard_normal((*shape, ROWS))
        recall = recall + scale * (0.8 * shared + 0.6 * own)
    tp = OCCUPIED * recall
    return Trainings(np.stack([2 * tp, tp + OCCUPIED], axis=-1), learned=True)


def coverage(trainings: int, level: float, draws: int, *, over_trainings: bool) -> float:
    """Share of intervals that hold 0; without `over_trainings` from the variance over recordings alone."""
    rng, held = np.random.default_rng(trainings), 0
    for _ in range(draws):
        difficulty = DIFFICULTY * rng.standard_normal((1, UNITS, 1))
        sides = [drawn(rng, trainings, level, difficulty) for _ in range(2)]
        if not over_trainings:
            sides = [Trainings(side.sums[:1], learned=False) for side in sides]
        found = training_differences(sides[0], sides[1])
        held += int(((found.low <= 0) & (found.high >= 0)).sum())
    return held / (draws * ROWS)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--draws", type=int, default=1000)
    parser.add_argument("--out", type=Path, help="results file that keeps the table")
    given = parser.parse_args()
    columns = ["spread of the level", "over recordings alone", *(f"{count} trainings" for count in TRAININGS)]
    rows = []
    for level in LEVELS:
        covered = [coverage(1, level, given.draws, over_trainings=False)]
        covered += [coverage(count, level, given.draws, over_trainings=True) for count in TRAININGS]
        rows.append([f"{level:g}", *(f"{share:.1%}" for share in covered)])
        print(rows[-1], flush=True)
    write_table(given.out, "trainings", measured_table(columns, rows), "python -m studies.training_intervals")


if __name__ == "__main__":
    main()
