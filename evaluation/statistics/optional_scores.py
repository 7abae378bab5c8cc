"""Scores of the optional parts of forecasts, velocities and sampled futures, from the sums of statistical units."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
import polars as pl
from numpy.typing import NDArray

from gridtrack.evaluation.results.columns import ENERGY_TABLE, FLOW_TABLE, ParquetTable
from gridtrack.evaluation.scoring.energy import ENERGY_STRATA
from gridtrack.evaluation.scoring.flow_errors import FLOW_STRATA
from gridtrack.evaluation.scoring.metrics import ratio
from gridtrack.evaluation.statistics.finished_trial import FinishedTrial
from gridtrack.evaluation.statistics.frame_counts import read_rows
from gridtrack.evaluation.statistics.jackknife import Floats, proportion_interval, ratio_differences, ratio_interval
from gridtrack.evaluation.statistics.spatial_scores import ScoreWithEnds, SpatialScores, add_curves, refuse_other_frames
from gridtrack.evaluation.statistics.units import UnitRule, sum_by_unit


def flow_scores(sums: Floats) -> Iterator[ScoreWithEnds]:
    """Scores (S, K) of velocities, of sums (U, S, K, 4) of units, in the order of the columns of FLOW_TABLE."""
    cells, given, error, speed = np.moveaxis(sums, -1, 0)
    yield "flow_error", ratio(error.sum(axis=0), given.sum(axis=0)), *ratio_interval(error, given)
    yield "flow_speed", ratio(speed.sum(axis=0), given.sum(axis=0)), *ratio_interval(speed, given)
    yield "flow_coverage", ratio(given.sum(axis=0), cells.sum(axis=0)), *proportion_interval(given, cells)


def energy_scores(sums: Floats) -> Iterator[ScoreWithEnds]:
    """Scores (S, K) of sampled futures, of sums (U, S, K, 3) of units, in the order of the columns of ENERGY_TABLE."""
    forecasts, distance, spread = np.moveaxis(sums, -1, 0)
    score = ratio_differences((distance, forecasts), (spread, forecasts))
    yield "energy_score", score.value, score.low, score.high
    yield "energy_spread", ratio(spread.sum(axis=0), forecasts.sum(axis=0)), *ratio_interval(spread, forecasts)


_PARTS: Sequence[tuple[ParquetTable, tuple[str, ...], Callable[[Floats], Iterator[ScoreWithEnds]]]] = (
    (FLOW_TABLE, FLOW_STRATA, flow_scores),
    (ENERGY_TABLE, ENERGY_STRATA, energy_scores),
)


def optional_scores(
    trials: Sequence[FinishedTrial], stamps_ns: Sequence[NDArray[np.int64]], strata: Sequence[str], rule: UnitRule
) -> SpatialScores:
    """The scores of `trials` pooled, in those of `strata` that have them; none of a part that a trial does not have.

    `stamps_ns` (F,) are the scored frames of each trial. Raises ScoresError.
    """
    found: SpatialScores = {name: {} for name in strata}
    units = rule.units_of(stamps_ns)
    for table, written, scores in _PARTS:
        if all((trial.folder / table.file).exists() for trial in trials):
            sums = [_read(table, written, *one) for one in zip(trials, stamps_ns, strict=True)]
            add_curves(found, written, scores(sum_by_unit(sums, units)))
    return found


def _read(
    table: ParquetTable, strata: Sequence[str], trial: FinishedTrial, stamps_ns: NDArray[np.int64]
) -> NDArray[np.float32]:
    """The sums (F, S, K, C) of a trial, of all columns of `table` after its keys. Raises ScoresError."""
    path, steps, columns = trial.folder / table.file, trial.record.steps, table.names[3:]
    rows = read_rows(path, columns, steps, strata)
    refuse_other_frames(path, rows, (steps + 1) * len(strata), stamps_ns)
    sums = rows.select(pl.col(columns).cast(pl.Float32)).to_numpy()
    return sums.reshape(len(stamps_ns), steps + 1, len(strata), len(columns))[:, trial.steps]
