"""A trial that follows a recording while it is written: live in real time, then scored on the whole recording."""

from __future__ import annotations

import threading
import time
from concurrent.futures import Future
from pathlib import Path

import numpy as np

from gridtrack.evaluation.engines.engine import Interrupted
from gridtrack.evaluation.hosting.outcome import TrialEnded
from gridtrack.evaluation.referee.deadline import DeadlineTracker, spare_steps
from gridtrack.evaluation.referee.live_timeline import ForecastStore, LiveTimeline, Presented, StoredForecasts
from gridtrack.evaluation.referee.referee import WARM_UP, Delivery, Schedule, TrackerLike
from gridtrack.evaluation.referee.splits import SplitMoments
from gridtrack.evaluation.runs.passes import Followed, Quantiles
from gridtrack.evaluation.runs.plan import Trial
from gridtrack.evaluation.runs.shared_thresholds import SharedThresholds
from gridtrack.evaluation.runs.trial import OnFrame, TrialRun
from gridtrack.evaluation.runs.trial_record import TrialEnding, TrialRecord
from gridtrack.evaluation.scores.thresholds import Thresholds
from gridtrack.trackers.contract import Forecast

TRIAL_FORECASTS = 4
"""Forecasts at the end of the warm-up; their duration decides how far ahead the later ones reach."""


class FollowedTrial(TrialRun):
    """A trial of a recording that is still being written. `run` is for a thread of its own.

    `ready` is set when the tracker can receive frames, or cannot be used at all. Frames are presented in `live`; at
    the end `score` hands in the whole recording, and the forecasts are scored.
    """

    def __init__(
        self, trial: Trial, moments: SplitMoments, folder: Path, on_frame: OnFrame, shared: SharedThresholds
    ) -> None:
        super().__init__(trial, moments, folder, on_frame, shared)
        self.ready = threading.Event()
        self.live = LiveTimeline()
        self.store = ForecastStore(folder)
        self.endless = Schedule(1 << 62, trial.split.steps, trial.split.every)
        """The frames that are forecast from, while the end of the recording is not known."""
        self._whole: Future[tuple[Trial, SplitMoments]] = Future()
        self._reach = trial.split.steps
        self._trial_ms = 0.0
        self._is_scored = False
        self._last_frame: int | None = None
        self._failed: tuple[int, Exception] | None = None

    @property
    def chosen(self) -> Thresholds | None:
        """The thresholds in use; None before they are chosen."""
        return self._thresholds

    def close_deadline(self, index: int) -> None:
        """Keep the forecast that is scored at the frame `index`, presented last; its deadline has passed.

        Raises OSError.
        """
        delivered = self.live.close(index)
        if delivered is not None and self.endless.due(index):
            self.store.add(delivered)

    def score(self, trial: Trial, moments: SplitMoments) -> None:
        """Start the scoring on `trial`, which has the frames that were presented."""
        self._whole.set_result((trial, moments))

    def abandon(self) -> None:
        """End the trial now, without a record if it is not scored yet."""
        self.live.end()
        if not self._whole.done():
            self._whole.set_exception(Interrupted())
        self.interrupt()

    def run(self) -> TrialRecord:
        """Run until the trial ends, successfully or not, and write the record."""
        try:
            return super().run()
        finally:
            self.store.close()

    def _run(self) -> tuple[TrialEnding, str]:
        ending = super()._run()
        if not self._is_scored:
            self._leave()
            self._await_whole()
        return ending

    def _expectation(self) -> None:
        """A recording that is still being written has no frame yet to ask with."""

    def _score(self, thresholds: Thresholds) -> None:
        """Process the frames in real time, and score the forecasts when the whole recording is known."""
        try:
            self._process.reset(self.trial.seed)
            self.ready.set()
            while (presented := self.live.take()) is not None:
                self._process_frame(presented)
        except TrialEnded as ended:
            if self._last_frame is None:
                raise
            self._failed = self._last_frame, ended
        self._leave()
        self._await_whole()
        self._is_scored = True
        self._refuse_moving(self._process.description)
        super()._score(thresholds)

    def _process_frame(self, presented: Presented) -> None:
        """Update, and forecast at the end of the warm-up, and after it at frames that are due or have a deadline."""
        index, began_s = presented.number, time.perf_counter()
        self._last_frame = index
        self._process.update(presented.frame)
        forecast: Forecast | None = None
        on_trial = WARM_UP - TRIAL_FORECASTS <= index < WARM_UP
        if on_trial or self.endless.due(index) or (presented.has_deadline and index >= WARM_UP):
            forecast = self._process.predict(self._reach)
        self.live.deliver(index, forecast)
        if on_trial and index > WARM_UP - TRIAL_FORECASTS:
            self._trial_ms = max(self._trial_ms, (time.perf_counter() - began_s) * 1e3)
        if index == WARM_UP - 1:
            self._extend_horizon()

    def _extend_horizon(self) -> None:
        """Extend the horizon of a tracker that is slower than the frames by its delay."""
        period_ms = self.trial.test.period_s * 1e3
        if self._trial_ms > period_ms:
            self._reach += spare_steps(self._trial_ms, period_ms, self._reach)

    def _leave(self) -> None:
        self.live.leave()
        self.ready.set()

    def _await_whole(self) -> None:
        trial, moments = self._whole.result()
        self.trial, self._moments, self._test = trial, moments, trial.split.schedule
        self._delivery = Delivery(moments.test, self._on_frame)

    def _tracker(self) -> TrackerLike:
        """The tracker of the forecasts that were in time."""
        timeline, test = self.live.timeline, self.trial.test
        stored = StoredForecasts(self.store, timeline, self._failed)
        return DeadlineTracker(stored, timeline.lasting(self._test.frames), self._test, self._reach, test.grid.cell_m)

    def _record(self, ending: TrialEnding, reason: str) -> TrialRecord:
        timed = self.live.timed
        ages = np.arange(len(timed.newest)) - timed.newest
        followed = Followed(
            frames=len(ages),
            missed=timed.missed,
            age_frames=Quantiles.of(ages) if len(ages) else None,
            forecast_steps=self._reach,
        )
        return super()._record(ending, reason).model_copy(update={"followed": followed})
