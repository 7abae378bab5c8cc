"""The objective that `fit` receives: a tracker scored in this process."""

from __future__ import annotations

from gridtrack.common.errors import RecordingError
from gridtrack.evaluation.referee.kinds import Regions
from gridtrack.evaluation.referee.motion import MotionFinder
from gridtrack.evaluation.referee.referee import Delivery, Schedule, scored_forecasts
from gridtrack.evaluation.referee.strata import STRATA
from gridtrack.evaluation.scores.cells import Tally, count_cells
from gridtrack.evaluation.scores.definition import divided
from gridtrack.evaluation.scores.f1 import f1_of
from gridtrack.evaluation.scores.thresholds import best_thresholds
from gridtrack.trackers.contract import FrameSource, StretchScore, Tracker

FIT_FORECAST_EVERY = 5
"""A forecast after every fifth frame: accurate enough to choose parameters, at a fifth of the cost."""


def score_in_process(
    tracker: Tracker, source: FrameSource, steps: int, regions: Regions, motion: MotionFinder | None = None
) -> StretchScore:
    """Stream `source` through the tracker and score its forecasts with the referee's counts, on its regions.

    `motion`: as in Delivery. Thresholds are chosen on the same stretch: a score for choosing parameters, not for
    reports. Raises RecordingError if the stretch is too short to score a forecast.
    """
    schedule = Schedule(len(source), steps, FIT_FORECAST_EVERY)
    if not schedule.expected:
        raise RecordingError(f"{source.name}: {len(source)} frames are too few to score forecasts of {steps} steps")
    tally = Tally.empty(steps)
    for scored in scored_forecasts(tracker, Delivery(source, lambda: None, regions, motion), schedule, seed=0):
        tally.add(count_cells(scored.forecast.occupancy, scored.targets, scored.region_maps))
    confusion = tally.confusion(best_thresholds(tally, source.name).bins)
    f1, log_loss = f1_of(confusion), divided(tally.log_loss, tally.cells.sum(axis=-1))
    return StretchScore(
        {name: f1[:, k] for k, name in enumerate(STRATA)}, {name: log_loss[:, k] for k, name in enumerate(STRATA)}
    )
