"""A trial's test stretch scored again under another condition, at the thresholds of the trial."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from gridtrack.evaluation.results.trial_record import ThresholdsUsed
from gridtrack.evaluation.results.values import Curves
from gridtrack.evaluation.runs.plan import Trial
from gridtrack.evaluation.scoring import metrics
from gridtrack.evaluation.scoring.counting import Tally, count_forecast
from gridtrack.evaluation.scoring.moments import Moment
from gridtrack.evaluation.scoring.referee import TrackerLike, scored_forecasts
from gridtrack.evaluation.scoring.thresholds import bins_of


def replayed_f1(tracker: TrackerLike, frames: Iterable[Moment], trial: Trial, thresholds: ThresholdsUsed) -> Curves:
    """F1 per stratum and step of `tracker` on the trial's `frames`, at the frames that the trial scored."""
    tally = Tally.empty(trial.split.steps, trial.split.strata)
    for scored in scored_forecasts(tracker, frames, trial.split.schedule, trial.seed):
        tally.add(count_forecast(scored.forecast.occupancy, scored.targets, scored.region_maps, scored.ages))
    values = np.array([thresholds.values[name] for name in tally.strata]).T
    f1 = metrics.f1_score(tally.confusion(bins_of(values)))
    return {
        name: tuple(None if math.isnan(value) else round(value, 6) for value in f1[:, k].tolist())
        for k, name in enumerate(tally.strata)
    }
