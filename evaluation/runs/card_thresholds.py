"""Thresholds on a card: chosen once after a training, for recordings without a validation stretch of their own."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.files import sha256_of
from gridtrack.common.grid import nearest_step
from gridtrack.evaluation.hosting.limits import Limits
from gridtrack.evaluation.referee.kinds import CellKinds, Regions
from gridtrack.evaluation.referee.referee import WARM_UP, Delivery
from gridtrack.evaluation.referee.splits import EvaluationSplit
from gridtrack.evaluation.referee.strata import STRATA, STRATA_WITH_TRUTH
from gridtrack.evaluation.runs.learned import LearnedWeights
from gridtrack.evaluation.runs.plan import Trial
from gridtrack.evaluation.runs.trial import validation_tally
from gridtrack.evaluation.scores.cells import HALF, Tally
from gridtrack.evaluation.scores.thresholds import Thresholds, best_thresholds
from gridtrack.recordings.stream import GridStream
from gridtrack.trackers.selection import Selection, launch
from gridtrack.trackers.training.card import CardThresholds
from gridtrack.trackers.training.progress import Progress
from gridtrack.trackers.training.weights import read_card

HORIZON_STEP_S, LAST_S = 0.1, 2.5
"""A card has thresholds for horizons in steps of HORIZON_STEP_S up to LAST_S; the last one counts beyond it too."""
FORECAST_EVERY_S = 1.0
THRESHOLDS_LOG = "thresholds.log"


def choose_card_thresholds(
    tracker: str, path: Path, validation: Sequence[tuple[GridStream, CellKinds]], progress: Progress
) -> CardThresholds | None:
    """The thresholds with the best F1 of `tracker` with the weights at `path`, on all `validation` stretches together.

    Each with the kinds of its cells, which the training found on its own stretches: nothing is found on the rest of a
    recording, which may be scored later. None if all of them are too short. Raises TrialEnded if the tracker
    fails, RecordingError.
    """
    validation = [(stream, kinds) for stream, kinds in validation if _steps(stream)]
    if not validation:
        return None
    strata = STRATA_WITH_TRUTH if all(stream.has_truth for stream, _ in validation) else STRATA
    total = Tally.empty(round(LAST_S / HORIZON_STEP_S), strata)
    with progress.stage("thresholds on recording", len(validation)) as stage:
        for stream, kinds in validation:
            _add(total, _tally(tracker, path, stream, kinds, progress).of(strata), stream.period_s)
            stage.advance()
    bins = _filled(best_thresholds(total, "").bins, total.positives.sum(axis=2) > 0)
    values = Thresholds(bins, strata=strata).values
    return CardThresholds(
        step_s=HORIZON_STEP_S, values={name: tuple(values[:, k].tolist()) for k, name in enumerate(strata)}
    )


def _steps(stream: GridStream) -> int:
    """Steps of the forecasts from a stretch: up to LAST_S, and so few that half of a short stretch is forecast from."""
    return min(nearest_step(LAST_S, stream.period_s), (len(stream) - WARM_UP) // 2)


def _tally(tracker: str, path: Path, stream: GridStream, kinds: CellKinds, progress: Progress) -> Tally:
    """The counts on one stretch with these `kinds` of its cells, by its own steps."""
    recording, every = stream.recording.path, max(1, round(FORECAST_EVERY_S / stream.period_s))
    split = EvaluationSplit(recording.stem, recording, stream, stream, _steps(stream), every)
    weights = LearnedWeights(path, read_card(path), sha256_of(path), path.parent)
    trial = Trial(Selection(tracker, tracker), launch(tracker), split, weights, seed=0, limits=Limits())
    log = path.with_suffix(".logs") / THRESHOLDS_LOG
    log.parent.mkdir(exist_ok=True)
    with trial.tracker_process(log) as process, progress.stage("frame", len(stream)) as frames:
        delivery = Delivery(stream, frames.advance, Regions(stream.grid, kinds, split.strata))
        return validation_tally(process, delivery, split, seed=0)


def _add(total: Tally, counted: Tally, period_s: float) -> None:
    """Add counts by steps of `period_s` to those by steps of HORIZON_STEP_S: each to the nearest horizon."""
    nearest = np.rint(np.arange(len(counted.cells)) * period_s / HORIZON_STEP_S).astype(np.int64)
    kept = nearest < len(total.cells)
    np.add.at(total.cells, nearest[kept], counted.cells[kept])
    np.add.at(total.positives, nearest[kept], counted.positives[kept])


def _filled(bins: NDArray[np.int64], known: NDArray[np.bool_]) -> NDArray[np.int64]:
    """The `bins` (S, K); bins that are not `known` (S, K) come from the nearest known step; 0.5 without any."""
    filled = np.full_like(bins, HALF)
    for k in range(bins.shape[1]):
        steps = np.flatnonzero(known[:, k])
        if len(steps):
            nearest = np.abs(np.arange(len(bins))[:, None] - steps).argmin(axis=1)
            filled[:, k] = bins[steps[nearest], k]
    return filled
