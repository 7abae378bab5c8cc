"""P-values of the rows: of a fall in F1 given the variation between units, and given the spread between trainings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gridtrack.evaluation.regression.pairing import PairedRow
from gridtrack.evaluation.regression.significance import fall_p_values
from gridtrack.evaluation.regression.spread import beyond_spread, spread_between
from gridtrack.evaluation.scoring.metrics import f1_score
from gridtrack.evaluation.statistics.jackknife import LEAST_UNITS


@dataclass(frozen=True, slots=True)
class RowPValue:
    """`p` of a row's fall, corrected for the family of all rows; None where there are too few units.

    `spread`: the standard deviation of its F1 between trainings; None where the baseline has one run.
    """

    p: float | None = None
    spread: float | None = None


def row_p_values(paired: Sequence[PairedRow]) -> list[RowPValue]:
    """The p-value of each row: the larger of that from the units and that from the spread between trainings.

    With too few units p is None; with a baseline of one run the spread is unknown and the units alone decide.
    """
    if not paired or len(paired[0].recordings) < LEAST_UNITS:
        return [RowPValue() for _ in paired]
    baseline = np.stack([row.baseline for row in paired], axis=1)
    run = np.stack([row.run for row in paired], axis=1)
    by_units = fall_p_values(baseline, run)
    if len(paired[0].trainings) == 1:
        return [RowPValue(p) for p in by_units.tolist()]
    fall = np.nan_to_num(f1_score(baseline.sum(axis=0)) - f1_score(run.sum(axis=0)))
    found: list[RowPValue] = []
    for label in dict.fromkeys(row.label for row in paired):
        own = [index for index, row in enumerate(paired) if row.label == label]
        spread = spread_between(np.stack([paired[index].trainings for index in own], axis=2))
        p = np.maximum(by_units[own], beyond_spread(fall[own], spread, len(paired)))
        found += map(RowPValue, p.tolist(), spread.deviation.tolist())
    return found
