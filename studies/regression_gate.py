"""Error rates of the regression gate's test of F1: false alarms between trainings of one tracker, and missed falls.

`python -m studies.regression_gate [RUN RUN RUN...]` (twenty minutes): three runs or more of the same tracker, trained
anew for each, on the same twenty recordings or more; without them, `kalman` with four settings is run on the junction's
test recordings. Aims: worse in at most 5 % of 200 resampled comparisons; a decrease of 0.02 F1 on dynamic cells in the
step band of 1 s found in at least 95 of 100.

Every comparison draws as many recordings as there are, with replacement. For a decrease, hits of the judged run become
misses, more in some recordings than in others, until dynamic F1 has decreased by 0.02. Three tables:

1. Exchanged units: in each recording it is random which of the two best runs is the baseline.
2. Trainings as observed: each run but the best against baselines of others that include the best; and each run against
   all others.
3. Simulated trainings: a normal mixture of the runs' deviations from their mean, of which none differs systematically.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from gridtrack.evaluation.regression.criteria import row_tests
from gridtrack.evaluation.regression.measurement import Baseline
from gridtrack.evaluation.regression.measuring import measure_run
from gridtrack.evaluation.regression.rows import PairedRow, paired_rows
from gridtrack.evaluation.regression.settings import MARGIN
from gridtrack.evaluation.regression.significance import FAMILY_LEVEL, swap_test
from gridtrack.evaluation.regression.spread import beyond_spread
from gridtrack.evaluation.runs.plan import resolve
from gridtrack.evaluation.runs.runner import run
from gridtrack.evaluation.runs.settings import CompareSettings
from gridtrack.evaluation.statistics.jackknife import holm, ratio_differences
from gridtrack.evaluation.statistics.training_spread import PRIOR_FREEDOM, spread_between, value_of

from studies.support.progress import NoProgress
from studies.support.shipped import JUNCTION, junction_tests

SETTINGS = ("", ":position_noise_m=0.05", ":acceleration=0.1", ":link_m=0.3")
"""Options of `kalman` with nearly equal scores: in place of trainings where none are given."""
RESAMPLED, FALLS = 200, 100
FALL, STRATUM, BAND = 0.02, "dynamic", "middle"
Floats = NDArray[np.float64]
"""Numerator and denominator of F1 (U, R, 2) in units and rows; of trainings (K, U, R, 2)."""
Rule = Callable[[Floats, Floats], Floats]
"""From the counts of the baseline's trainings and of a run to p (R,)."""
Comparison = tuple[Floats, Floats]
"""The counts of the baseline's trainings, and those of a run."""


@dataclass(frozen=True)
class Runs:
    """Counts of every run, what their rows are, and which of them the fall is made in."""

    trainings: Floats
    rows: tuple[PairedRow, ...]

    @property
    def aim(self) -> int:
        """The row of the fall."""
        return next(i for i, row in enumerate(self.rows) if (row.region, row.band) == (STRATUM, BAND))

    def by_gate(self, trainings: Floats, judged: Floats) -> Floats:
        """The gate's own p."""
        paired = [
            replace(row, trainings=trainings[:, :, i], run=judged[:, i], units=np.arange(len(judged)))
            for i, row in enumerate(self.rows)
        ]
        return np.array([test.p for test in row_tests(paired)])


def by_holm(trainings: Floats, judged: Floats) -> Floats:
    """Student's t of the paired differences, Holm's correction over all rows."""
    return holm(uncorrected(trainings, judged))


def uncorrected(trainings: Floats, judged: Floats) -> Floats:
    """Student's t of the paired differences, each row by itself."""
    run, baseline = ((side[..., 0], side[..., 1]) for side in (judged, trainings.mean(axis=0)))
    found = ratio_differences(run, baseline)
    return np.where(found.value < 0, found.p / 2, 1.0)


def no_statistics(trainings: Floats, judged: Floats) -> Floats:
    """p = 0: every decrease beyond the margin counts."""
    return np.zeros(judged.shape[1])


def by_units(trainings: Floats, judged: Floats) -> Floats:
    """As if the trainings' mean were one run."""
    return swap_test(trainings.mean(axis=0), judged, np.ones(judged.shape[1])).p


def with_prior(freedom: float) -> Rule:
    """The gate's with another weight of what the rows of a tracker have in common."""

    def rule(trainings: Floats, judged: Floats) -> Floats:
        spread = spread_between(trainings, freedom)
        fall = np.nan_to_num(value_of(trainings.mean(axis=0).sum(axis=0)) - value_of(judged.sum(axis=0)))
        return np.maximum(by_units(trainings, judged), beyond_spread(fall, spread, judged.shape[1]))

    return rule


def is_worse(rule: Rule, trainings: Floats, judged: Floats) -> NDArray[np.bool_]:
    """Which rows (R,) are worse: beyond the margin, and no chance."""
    fall = np.nan_to_num(value_of(trainings.mean(axis=0).sum(axis=0)) - value_of(judged.sum(axis=0)))
    return (fall > MARGIN) & (rule(trainings, judged) <= FAMILY_LEVEL)


def with_decrease(counts: Floats, row: int, rng: np.random.Generator) -> Floats:
    """`counts` with hits of the stratum's `row` turned into misses until its F1 has fallen by FALL.

    A unit loses a share of its hits that varies by half from unit to unit.
    """
    made = counts.copy()
    varies = rng.gamma(4.0, 0.25, len(counts))
    target = value_of(counts[:, row].sum(axis=0)) - FALL
    low, high = 0.0, 1.0
    for _ in range(40):
        share = (low + high) / 2
        lost = np.round(counts[:, row, 0] / 2 * np.clip(share * varies, 0.0, 1.0))
        made[:, row] = counts[:, row] - lost[:, None] * [2.0, 1.0]
        low, high = (share, high) if value_of(made[:, row].sum(axis=0)) > target else (low, share)
    return made


def exchanged(one: Floats, other: Floats, rng: np.random.Generator) -> Comparison:
    """Of two runs, in each unit drawn, chance decides which is the baseline's."""
    drawn = rng.integers(0, len(one), len(one))
    swap = rng.integers(0, 2, (len(one), 1, 1)).astype(bool)
    return np.where(swap, other[drawn], one[drawn])[None], np.where(swap, one[drawn], other[drawn])


def as_observed(trainings: Floats, others: int, rng: np.random.Generator) -> Comparison:
    """A run but the best, the first, against a baseline of the best and, but for it, `others` drawn among the rest."""
    judged, *rest = rng.permutation(np.arange(1, len(trainings)))
    drawn = rng.integers(0, trainings.shape[1], trainings.shape[1])
    return trainings[[0, *rest[:others]]][:, drawn], trainings[judged][drawn]


def left_out(trainings: Floats, rng: np.random.Generator) -> Comparison:
    """A run against all others."""
    judged = int(rng.integers(0, len(trainings)))
    drawn = rng.integers(0, trainings.shape[1], trainings.shape[1])
    return np.delete(trainings, judged, axis=0)[:, drawn], trainings[judged][drawn]


def simulated(trainings: Floats, count: int, rng: np.random.Generator) -> Comparison:
    """`count` trainings and one more, each the runs' mean and a normal mixture of their deviations from it."""
    mean = trainings.mean(axis=0)
    weights = rng.standard_normal((count + 1, len(trainings))) / np.sqrt(len(trainings) - 1)
    drawn = rng.integers(0, trainings.shape[1], trainings.shape[1])
    made = np.maximum(mean + np.tensordot(weights, trainings - mean, 1), 0.0)[:, drawn]
    return made[:-1], made[-1]


def print_rule(name: str, rule: Rule, draw: Callable[[np.random.Generator], Comparison], aim: int) -> None:
    """Print how often `rule` calls a drawn comparison worse, and how often it finds a decrease in it."""
    rng = np.random.default_rng(1)
    alarms = found = 0
    for number in range(RESAMPLED):
        trainings, judged = draw(rng)
        alarms += bool(is_worse(rule, trainings, judged).any())
        if number < FALLS:
            found += bool(is_worse(rule, trainings, with_decrease(judged, aim, rng))[aim])
    print(f"{name:50} {f'{100 * alarms / RESAMPLED:.1f} %':>14} {f'{found} of {FALLS}':>12}", flush=True)


def print_heading(title: str) -> None:
    print(f"\n{title:50} {'called worse':>14} {'found':>12}")


def print_tables(runs: Runs) -> None:
    trainings, aim, gate = runs.trainings, runs.aim, runs.by_gate
    f1 = value_of(trainings.sum(axis=1))
    print(f"{trainings.shape[1]} units, {trainings.shape[2]} rows, {len(trainings)} runs, the best one first")
    print(
        f"F1 from run to run up to {np.nanmax(np.ptp(f1, axis=0)):.4f} apart; {STRATUM}, {BAND}: {f1[:, aim].round(4)}"
    )

    print_heading("1. exchanged units")
    rules: dict[str, Rule] = {
        "the gate's: swaps, max-T over the family": gate,
        "t test, Holm over the family": by_holm,
        "t test, uncorrected": uncorrected,
        "margin alone": no_statistics,
    }
    for name, rule in rules.items():
        print_rule(name, rule, lambda rng: exchanged(trainings[0], trainings[1], rng), aim)

    print_heading("2. trainings as observed: baseline of")
    for others in range(len(trainings) - 1):
        name = f"the best and {others} more" if others else "the best alone"
        print_rule(name, gate, lambda rng, others=others: as_observed(trainings, others, rng), aim)
    print_rule("all but the one judged", gate, lambda rng: left_out(trainings, rng), aim)

    print("\nsmallest fall that can be found, in standard deviations from training to training")
    for count in (2, 3, 5):
        t = stdtrit(PRIOR_FREEDOM + count - 1, 1 - FAMILY_LEVEL / trainings.shape[2])
        print(f"baseline of {count}: {t * np.sqrt(1 + 1 / count):.1f}")

    print_heading("3. simulated trainings")
    for name, rule, count in simulation_rules(gate):
        print_rule(f"{name}, baseline of {count}", rule, lambda rng, count=count: simulated(trainings, count, rng), aim)


def simulation_rules(gate: Rule) -> Iterator[tuple[str, Rule, int]]:
    """Rules for simulated trainings, and the number of trainings of the baseline."""
    for count in (1, 2, 3, 5):
        yield "the gate's", gate, count
    for freedom in (0.0, PRIOR_FREEDOM / 2, PRIOR_FREEDOM * 2):
        for count in (2, 3):
            yield f"with {freedom:g} degrees of freedom shared", with_prior(freedom), count


def junction_runs(folder: Path) -> list[Path]:
    """Runs of `kalman` on the junction's test recordings, each with other settings."""
    recordings = tuple(map(str, junction_tests()))
    made = [folder / str(number) for number in range(len(SETTINGS))]
    for out, options in zip(made, SETTINGS, strict=True):
        settings = CompareSettings(
            recordings=recordings, trackers=(f"kalman=kalman{options}",), out=out,
            validation=f"{JUNCTION / 'validation.tracks'}@0s-60s",
        )  # fmt: skip
        run(resolve(settings), (), NoProgress())
    return made


def read_runs(paths: list[Path]) -> Runs:
    """What the runs counted, the best by its mean F1 over all rows first."""
    first = measure_run(paths[0])
    baseline = Baseline(digest="", runs=(first, *(measure_run(path, like=first) for path in paths[1:])))
    rows = tuple(row for row in paired_rows(baseline, first) if row.score == "F1")
    trainings = np.stack([row.by_unit(row.trainings) for row in rows], axis=2)
    best = np.argsort(-np.nanmean(value_of(trainings.sum(axis=1)), axis=1))
    return Runs(trainings[best], rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("runs", type=Path, nargs="*", help="folders of runs; default: four settings of kalman are run")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        print_tables(read_runs(arguments.runs or junction_runs(Path(folder))))


if __name__ == "__main__":
    main()
