"""The criteria of a row: significance over units and trainings, large falls, collapses, and the least fall found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gridtrack.evaluation.regression.noise import UnitFalls, standard_error, unit_falls
from gridtrack.evaluation.regression.rows import PairedRow
from gridtrack.evaluation.regression.significance import FAMILY_LEVEL, SwapTest, swap_test
from gridtrack.evaluation.regression.spread import beyond_spread, least_beyond
from gridtrack.evaluation.statistics.jackknife import LEAST_UNITS, Floats
from gridtrack.evaluation.statistics.training_spread import spread_between, value_of

LARGE_MARGINS = 4.0
"""A pooled fall of more than this many margins is worse whatever its p-value over units."""
COLLAPSE = 0.1
"""A fall in F1 on one recording of more than this, or of more than LARGE_MARGINS margins, is a collapse."""
LARGE_ERRORS, COLLAPSE_ERRORS = 4.0, 6.0
"""Standard errors of the typical unit (`noise`) that a large fall, and a collapse, must exceed. A run has hundreds of
rows times recordings that can collapse, so the latter is larger."""


@dataclass(frozen=True, slots=True)
class RowTest:
    """What is known of the chance of a row's fall; all None and 0 where there are too few units.

    `p`: the p-value over units and trainings, corrected for all rows; `p_trainings` the part over trainings. `spread`:
    the standard deviation of the score between trainings, None where it is not known. `least`: the smallest fall, alike
    in all units, that would have been significant. `error`: the standard error from the typical unit.
    """

    p: float | None = None
    p_trainings: float = 0.0
    spread: float | None = None
    least: float = 0.0
    least_of_trainings: float = 0.0
    error: float = 0.0

    def is_large(self, fall: float, limit: float) -> bool:
        """Whether a fall is worse whatever its p-value over units: beyond `limit`, the noise and other trainings."""
        return fall > max(limit, LARGE_ERRORS * self.error) and self.p_trainings <= FAMILY_LEVEL

    def smallest(self, margin: float, limit: float) -> float:
        """The smallest fall, alike in all units, that would have been worse."""
        significant = max(margin, self.least, self.least_of_trainings)
        return min(significant, max(limit, LARGE_ERRORS * self.error, self.least_of_trainings))


def row_tests(rows: Sequence[PairedRow]) -> list[RowTest]:
    """The test of each row. With fewer than LEAST_UNITS units there is none."""
    if not rows or len(np.unique(rows[0].units)) < LEAST_UNITS:
        return [RowTest() for _ in rows]
    then, now = (np.stack([row.by_unit(side) for row, side in _both(rows, which)], axis=1) for which in (0, 1))
    swaps = swap_test(then, now, np.array([row.sign for row in rows]))
    tests = [_by_units(row, swaps, i) for i, row in enumerate(rows)]
    if len(rows[0].trainings) > 1:
        for label, score in dict.fromkeys((row.label, row.score) for row in rows):
            own = [i for i, row in enumerate(rows) if (row.label, row.score) == (label, score)]
            found = _by_trainings([rows[i] for i in own], [tests[i] for i in own], len(rows))
            tests = [found[own.index(i)] if i in own else test for i, test in enumerate(tests)]
    return tests


def _both(rows: Sequence[PairedRow], which: int) -> list[tuple[PairedRow, Floats]]:
    return [(row, (row.baseline, row.run)[which]) for row in rows]


def _by_units(row: PairedRow, swaps: SwapTest, index: int) -> RowTest:
    falls = unit_falls(row)
    return RowTest(
        float(swaps.p[index]),
        least=_least_significant(falls, swaps.critical),
        error=standard_error(row, np.ones(len(row.units), bool), falls),
    )


def _least_significant(falls: UnitFalls, critical: float) -> float:
    """The smallest fall, alike in all units, whose standardised value reaches `critical`.

    With what is left of the contributions, e_u, a fall f has the standardised value f / sqrt(f² sum w² + sum e²).
    """
    left = falls.contributions - falls.contributions.sum() * falls.weights
    room = 1 - critical**2 * float((falls.weights**2).sum())
    return critical * float(np.sqrt((left**2).sum() / room)) if room > 0 else float("inf")


def _by_trainings(rows: Sequence[PairedRow], tests: Sequence[RowTest], family: int) -> list[RowTest]:
    """The tests of one tracker's rows of one score, with the spread between the trainings of the baseline."""
    spread = spread_between(np.stack([row.by_unit(row.trainings) for row in rows], axis=2))
    then, now = (np.array([value_of(side.sum(axis=0)) for _, side in _both(rows, which)]) for which in (0, 1))
    p = beyond_spread(np.nan_to_num(rows[0].sign * (then - now)), spread, family).tolist()
    least = least_beyond(spread, family, FAMILY_LEVEL).tolist()
    return [
        RowTest(max(test.p or 0.0, p[i]), p[i], float(spread.deviation[i]), test.least, least[i], test.error)
        for i, test in enumerate(tests)
    ]
