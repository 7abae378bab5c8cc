"""What chance could do to each row: by the units that happen to be in the test, and by the training that was run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gridtrack.evaluation.regression.pairing import PairedRow
from gridtrack.evaluation.regression.significance import fall_p_values
from gridtrack.evaluation.regression.spread import beyond_spread, spread_between
from gridtrack.evaluation.scoring.metrics import f1_score
from gridtrack.evaluation.statistics.uncertainty import LEAST_UNITS


@dataclass(frozen=True, slots=True)
class RowPValue:
    """`p` of a row's fall, corrected for the family of all rows: None where units are too few for it.

    `spread` is the standard deviation of its F1 from training to training; None where one run tells nothing of it.
    """

    p: float | None = None
    spread: float | None = None


def row_p_values(paired: Sequence[PairedRow]) -> list[RowPValue]:
    """The chance of each row: a fall is as likely by chance as the likelier of the two, units and trainings, makes it.

    Where units are few there is none; where the baseline is of one run, trainings are unknown and units alone count.
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
