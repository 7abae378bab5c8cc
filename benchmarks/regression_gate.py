"""How often the gate is wrong: false alarms between two trainings of one tracker, and falls that it misses.

Run it by itself: `python benchmarks/regression_gate.py [RUN_A RUN_B]`, two runs of the same tracker, trained twice, on
the same twenty recordings or more; without them, `kalman` with two settings is run on the junction's test recordings,
which takes some minutes. Aims: worse in at most 5 % of 200 resampled comparisons; a fall of 0.02 F1 on moving cells
in the step band of 1 s found in at least 95 of 100.

A comparison draws as many recordings as there are, with replacement. For false alarms it is chance in each recording
which of the two trainings is the baseline, so neither is better; for a training that is better by chance of its seed,
both directions are printed as they are, and again with the tolerance that covers what separates the two, rounded up to
0.005. For the falls, hits of a training are turned into misses, more in some recordings than in others, until moving
F1 has fallen by 0.02, and the other training is the baseline.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from harness import Quiet
from numpy.typing import NDArray

from gridtrack.evaluation.comparison.plan import CompareSettings, resolve
from gridtrack.evaluation.comparison.runner import run
from gridtrack.evaluation.regression import GateSettings, measure
from gridtrack.evaluation.regression.pairing import PairedRow, pair
from gridtrack.evaluation.regression.significance import FAMILY_LEVEL, f1_of, fall_p_values
from gridtrack.evaluation.statistics.uncertainty import differences, holm

JUNCTION = Path(__file__).parents[1] / "data" / "junction"
RESAMPLED, FALLS = 200, 100
FALL, STRATUM, BAND = 0.02, "moving", "middle"
MARGIN = GateSettings().margin
Counts = NDArray[np.float64]
"""TP, FP, FN, TN (U, R, 4) of units and rows."""
Rule = Callable[[Counts, Counts], NDArray[np.float64]]
"""From a baseline and a run to p (R,)."""


def by_swaps(baseline: Counts, run: Counts) -> NDArray[np.float64]:
    """The gate's own."""
    return fall_p_values(baseline, run)


def by_holm(baseline: Counts, run: Counts) -> NDArray[np.float64]:
    """Student's t of the paired differences, Holm's correction over all rows."""
    return holm(_one_sided(baseline, run))


def uncorrected(baseline: Counts, run: Counts) -> NDArray[np.float64]:
    """Student's t of the paired differences, each row by itself."""
    return _one_sided(baseline, run)


def no_statistics(baseline: Counts, run: Counts) -> NDArray[np.float64]:
    """Whatever fell beyond the margin."""
    return np.zeros(baseline.shape[1])


RULES: dict[str, Rule] = {
    "swaps, max-T over the family (the gate's)": by_swaps,
    "t test, Holm over the family": by_holm,
    "t test, uncorrected": uncorrected,
    "margin alone": no_statistics,
}


def _one_sided(baseline: Counts, run: Counts) -> NDArray[np.float64]:
    padded = [np.concatenate([side, np.zeros((*side.shape[:2], 2))], axis=-1) for side in (run, baseline)]
    found = differences(*padded)
    return np.where(found.value < 0, found.p / 2, 1.0)


def worse(rule: Rule, margin: float, baseline: Counts, run: Counts) -> NDArray[np.bool_]:
    """Which rows (R,) are worse: beyond the margin, and significant."""
    fall = np.nan_to_num(f1_of(baseline.sum(axis=0)) - f1_of(run.sum(axis=0)))
    return (fall > margin) & (rule(baseline, run) <= FAMILY_LEVEL)


def swapped(one: Counts, other: Counts, rng: np.random.Generator) -> tuple[Counts, Counts]:
    """The two with chance deciding in each unit which is which."""
    swap = rng.integers(0, 2, (len(one), 1, 1)).astype(bool)
    return np.where(swap, other, one), np.where(swap, one, other)


def made_worse(counts: Counts, row: int, rng: np.random.Generator) -> Counts:
    """`counts` with hits of the stratum's `row` turned into misses until its F1 has fallen by FALL.

    A unit loses a share of its hits that varies by half from unit to unit.
    """
    made = counts.copy()
    varies = rng.gamma(4.0, 0.25, len(counts))
    target = f1_of(counts[:, row].sum(axis=0)) - FALL
    low, high = 0.0, 1.0
    for _ in range(40):
        share = (low + high) / 2
        lost = np.round(counts[:, row, 0] * np.clip(share * varies, 0.0, 1.0))
        made[:, row, 0], made[:, row, 2] = counts[:, row, 0] - lost, counts[:, row, 2] + lost
        low, high = (share, high) if f1_of(made[:, row].sum(axis=0)) > target else (low, share)
    return made


def print_rates(rows: tuple[PairedRow, ...]) -> None:
    one, other = (np.stack([getattr(row, side) for row in rows], axis=1) for side in ("baseline", "run"))
    aim = next(i for i, row in enumerate(rows) if (row.stratum, row.band) == (STRATUM, BAND))
    apart = f1_of(other.sum(axis=0)) - f1_of(one.sum(axis=0))
    print(f"{len(one)} units, {len(rows)} rows; trainings {np.nanmin(apart):+.4f} to {np.nanmax(apart):+.4f} apart")
    print(f"{STRATUM}, {BAND}: F1 {f1_of(one.sum(axis=0))[aim]:.4f} and {f1_of(other.sum(axis=0))[aim]:.4f}\n")
    print(f"{'rule':44} {'false alarms':>14} {'A to B':>8} {'B to A':>8} {'falls found':>12}")
    for name, rule in RULES.items():
        print_rule(name, rule, MARGIN, one, other, aim)
    tolerance = float(np.ceil(np.nanmax(np.abs(apart)) / 0.005)) * 0.005
    print_rule(f"the gate's, with a tolerance of {tolerance:.3f}", by_swaps, tolerance, one, other, aim)


def print_rule(name: str, rule: Rule, margin: float, one: Counts, other: Counts, aim: int) -> None:
    rng = np.random.default_rng(1)
    units = len(one)
    alarms, forward, backward, found = 0, 0, 0, 0
    for draw in range(RESAMPLED):
        drawn = rng.integers(0, units, units)
        alarms += worse(rule, margin, *swapped(one[drawn], other[drawn], rng)).any()
        forward += worse(rule, margin, one[drawn], other[drawn]).any()
        backward += worse(rule, margin, other[drawn], one[drawn]).any()
        if draw < FALLS:
            then, now = swapped(one[drawn], other[drawn], rng)
            found += worse(rule, margin, then, made_worse(now, aim, rng))[aim]
    rates = [f"{100 * count / RESAMPLED:.1f} %" for count in (alarms, forward, backward)]
    print(f"{name:44} {rates[0]:>14} {rates[1]:>8} {rates[2]:>8} {f'{found} of {FALLS}':>12}")


def junction_runs(folder: Path) -> tuple[Path, Path]:
    """Two runs of `kalman` on the junction's test recordings, with two settings that suit it about as well."""
    recordings = tuple(map(str, sorted(JUNCTION.glob("test-*.tracks"))))
    made = []
    for name, options in (("one", ""), ("other", ":position_noise_m=0.1")):
        settings = CompareSettings(
            recordings=recordings, trackers=(f"kalman=kalman{options}",), out=folder / name,
            validation=f"{JUNCTION / 'validation.tracks'}@0s-60s",
        )  # fmt: skip
        run(resolve(settings), (), Quiet())
        made.append(folder / name)
    return made[0], made[1]


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        one, other = map(Path, sys.argv[1:3]) if len(sys.argv) > 2 else junction_runs(Path(folder))
        baseline = measure(one)
        print_rates(pair(baseline, measure(other, like=baseline)))


if __name__ == "__main__":
    main()
