"""Scores of forecast velocities, with their intervals, from the sums of statistical units."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import polars as pl
from numpy.typing import NDArray

from gridtrack.evaluation.results.columns import FLOW_TABLE
from gridtrack.evaluation.scoring.flow_errors import FLOW_STRATA
from gridtrack.evaluation.scoring.metrics import ratio
from gridtrack.evaluation.statistics.finished_trial import FinishedTrial
from gridtrack.evaluation.statistics.frame_counts import read_rows
from gridtrack.evaluation.statistics.jackknife import Floats, proportion_interval, ratio_interval
from gridtrack.evaluation.statistics.spatial_scores import ScoreWithEnds, SpatialScores, add_curves, refuse_other_frames
from gridtrack.evaluation.statistics.units import UnitRule, sum_by_unit

_COLUMNS = ("cells", "given", "error", "speed")


def flow_scores(
    trials: Sequence[FinishedTrial], stamps_ns: Sequence[NDArray[np.int64]], strata: Sequence[str], rule: UnitRule
) -> SpatialScores:
    """The scores of `trials` pooled, in those of `strata` that have them; none where a trial has no velocities.

    `stamps_ns` (F,) are the scored frames of each trial. Raises ScoresError.
    """
    found: SpatialScores = {name: {} for name in strata}
    if all((trial.folder / FLOW_TABLE.file).exists() for trial in trials):
        sums = [_read(*one) for one in zip(trials, stamps_ns, strict=True)]
        add_curves(found, FLOW_STRATA, scores_of_units(sum_by_unit(sums, rule.units_of(stamps_ns))))
    return found


def scores_of_units(sums: Floats) -> Iterator[ScoreWithEnds]:
    """Scores (S, K) of sums (U, S, K, 4) of units, in the order of the columns of FLOW_TABLE."""
    cells, given, error, speed = np.moveaxis(sums, -1, 0)
    yield "flow_error", ratio(error.sum(axis=0), given.sum(axis=0)), *ratio_interval(error, given)
    yield "flow_speed", ratio(speed.sum(axis=0), given.sum(axis=0)), *ratio_interval(speed, given)
    yield "flow_coverage", ratio(given.sum(axis=0), cells.sum(axis=0)), *proportion_interval(given, cells)


def _read(trial: FinishedTrial, stamps_ns: NDArray[np.int64]) -> NDArray[np.float32]:
    """The sums (F, S, K, 4) of a trial. Raises ScoresError."""
    path, steps = trial.folder / FLOW_TABLE.file, trial.record.steps
    rows = read_rows(path, _COLUMNS, steps, FLOW_STRATA)
    refuse_other_frames(path, rows, (steps + 1) * len(FLOW_STRATA), stamps_ns)
    sums = rows.select(pl.col(_COLUMNS).cast(pl.Float32)).to_numpy()
    return sums.reshape(len(stamps_ns), steps + 1, len(FLOW_STRATA), len(_COLUMNS))[:, trial.steps]
