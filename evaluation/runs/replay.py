"""A trial's test stretch scored again under another condition, at the thresholds of the trial."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from gridtrack.evaluation.referee.referee import Moment, TrackerLike, scored_forecasts
from gridtrack.evaluation.runs.plan import Trial
from gridtrack.evaluation.runs.result_files import Curves
from gridtrack.evaluation.runs.trial_record import ThresholdsUsed
from gridtrack.evaluation.scores.cells import Tally, count_cells
from gridtrack.evaluation.scores.f1 import f1_of
from gridtrack.evaluation.scores.thresholds import bins_of


def replayed_f1(tracker: TrackerLike, frames: Iterable[Moment], trial: Trial, thresholds: ThresholdsUsed) -> Curves:
    """F1 per stratum and step of `tracker` on the trial's `frames`, at the frames that the trial scored."""
    tally = Tally.empty(trial.split.steps, trial.split.strata)
    for scored in scored_forecasts(tracker, frames, trial.split.schedule, trial.seed):
        tally.add(count_cells(scored.forecast.occupancy, scored.targets, scored.region_maps, scored.ages))
    values = np.array([thresholds.values[name] for name in tally.strata]).T
    f1 = f1_of(tally.confusion(bins_of(values)))
    return {
        name: tuple(None if math.isnan(value) else round(value, 6) for value in f1[:, k].tolist())
        for k, name in enumerate(tally.strata)
    }
