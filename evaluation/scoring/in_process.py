"""Scoring a tracker in this process: what `fit` is handed to tune and to choose by."""

from __future__ import annotations

from gridtrack.common.errors import RecordingError
from gridtrack.evaluation.scoring import metrics
from gridtrack.evaluation.scoring.counting import Tally, count_forecast
from gridtrack.evaluation.scoring.referee import Delivery, Schedule, scored_forecasts
from gridtrack.evaluation.scoring.strata import STRATA, cell_kinds_of, region_maps_of
from gridtrack.evaluation.scoring.thresholds import best_thresholds
from gridtrack.trackers.contract import FrameSource, StretchScore, Tracker

FIT_FORECAST_EVERY = 5
"""Forecast after every fifth frame: near enough to the whole for choosing, at a fifth of its cost."""


def score_in_process(tracker: Tracker, source: FrameSource, steps: int) -> StretchScore:
    """Stream `source` through the tracker and score its forecasts as the referee does, with the same counts.

    Each step's threshold is the best one on this very stretch, and the strata come from it too: a score to choose
    parameters by, and not one to report. Raises RecordingError where the stretch is too short to score anything.
    """
    schedule = Schedule(len(source), steps, FIT_FORECAST_EVERY)
    if not schedule.expected:
        raise RecordingError(f"{source.name}: {len(source)} frames are too few to score forecasts of {steps} steps")
    first = next(iter(source))
    region_maps = region_maps_of(cell_kinds_of(source, source.grid, first.world_T_grid), source.grid, first.origins)
    tally = Tally.empty(steps)
    for scored in scored_forecasts(tracker, Delivery(source, lambda: None), schedule, seed=0):
        tally.add(count_forecast(scored.forecast.occupancy, scored.targets, region_maps))
    confusion = tally.confusion(best_thresholds(tally, source.name).bins)
    f1, log_loss = metrics.f1_score(confusion), metrics.log_loss(tally)
    return StretchScore(
        {name: f1[:, k] for k, name in enumerate(STRATA)}, {name: log_loss[:, k] for k, name in enumerate(STRATA)}
    )
