"""Coverage of the intervals of scores, and of their paired differences, over drawn sets of recordings."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.statistics.jackknife import PairedDifferences

from studies.support.results_file import measured_table, write_table

MANY_UNITS = 4000
"""Units of the set whose scores are taken as the true ones."""
SHARES = ("interval covers, %", "difference covers, %", "p < 0.05, %")


class DrawnSet(NamedTuple):
    """Scores of a drawn set of recordings: value, low and high end by score, and differences of equally good trackers.

    A score may have no difference.
    """

    scores: Mapping[str, tuple[float, float, float]]
    differences: Mapping[str, PairedDifferences]


def skills_of_two(rng: np.random.Generator, units: int) -> NDArray[np.float64]:
    """How much easier than the mean each recording is for two trackers (2, units): most of it for both alike."""
    shared = rng.standard_normal(units)
    return np.stack([np.sqrt(0.8) * shared + np.sqrt(0.2) * rng.standard_normal(units) for _ in range(2)])


def covered(draw: Callable[[int], DrawnSet], units: int, repetitions: int) -> dict[str, list[str]]:
    """By score, as text: its true value, and SHARES over sets of `units` recordings; `draw(units)` draws one."""
    truth = {name: value for name, (value, _, _) in draw(MANY_UNITS).scores.items()}
    counted = {name: np.zeros(len(SHARES)) for name in truth}
    for _ in range(repetitions):
        scores, differences = draw(units)
        for name, (_, low, high) in scores.items():
            gap = differences.get(name)
            paired = [np.nan] * 2 if gap is None else [gap.low <= 0 <= gap.high, gap.p < 0.05]
            counted[name] += [low <= truth[name] <= high, *paired]
    percent = {name: 100 * found / repetitions for name, found in counted.items()}
    return {
        name: [f"{truth[name]:.2f}", *("" if np.isnan(share) else f"{share:.1f}" for share in shares)]
        for name, shares in percent.items()
    }


def print_coverage(
    description: str,
    section: str,
    command: str,
    columns: list[str],
    rows_of: Callable[[np.random.Generator, int], list[list[str]]],
) -> None:
    """The command line of a study: print the table of `rows_of(rng, repetitions)`, and write it where asked to."""
    parser = argparse.ArgumentParser(description=description.partition("\n")[0])
    parser.add_argument("--repetitions", type=int, default=300, help="simulated sets of recordings for each setting")
    parser.add_argument("--out", type=Path, help="results file, such as docs/results/statistics.json")
    arguments = parser.parse_args()
    table = measured_table([*columns, *SHARES], rows_of(np.random.default_rng(0), arguments.repetitions))
    print(table.markdown())
    write_table(arguments.out, section, table, command)
