"""A comparison that follows a recording while it is written: trackers in real time, then a run like any other."""

from __future__ import annotations

import hashlib
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from gridtrack.common.errors import RecordingError
from gridtrack.common.files import name_from
from gridtrack.common.notices import Notice, by_kind
from gridtrack.evaluation.engines.engine import WAKE_S, Engine, Interrupted
from gridtrack.evaluation.referee.kinds import regions_of
from gridtrack.evaluation.referee.referee import WARM_UP
from gridtrack.evaluation.referee.splits import EvaluationSplit, SplitMoments, SplitRegions, split_of
from gridtrack.evaluation.runs.arrivals import (
    BEHIND_S,
    Arrival,
    Arrivals,
    FileWatch,
    RealTimePace,
    open_growing,
    path_to_follow,
    refuse_raw,
)
from gridtrack.evaluation.runs.followed_trial import FollowedTrial
from gridtrack.evaluation.runs.live_scores import LiveObserver, LiveScores, LiveStatus
from gridtrack.evaluation.runs.plan import ComparisonPlan, resolve, sampling_of, with_copied_weights
from gridtrack.evaluation.runs.run_folder import RunFolder, refuse_earlier_run, run_lock
from gridtrack.evaluation.runs.runner import RunObserver, Stages, engine_of
from gridtrack.evaluation.runs.settings import CompareSettings
from gridtrack.evaluation.runs.shared_thresholds import SharedThresholds
from gridtrack.evaluation.runs.summary import RunSummary
from gridtrack.evaluation.runs.trial import error_with_location, failed
from gridtrack.evaluation.runs.trial_record import TrialRecord
from gridtrack.recordings import open_recording
from gridtrack.recordings.file_reading import Growth
from gridtrack.recordings.stream import frame_digest
from gridtrack.recordings.stretches import parse_stretch


@contextmanager
def following(
    settings: CompareSettings, watch: FileWatch | None = None, note: Callable[[str], None] = lambda text: None
) -> Iterator[Following]:
    """Wait until the recording of `settings` can be followed, and lock the folder of its run.

    `note` receives a line for the user while it waits. Raises a GridtrackError.
    """
    path = path_to_follow(settings)
    with run_lock(settings.out), TemporaryDirectory(prefix="gridtrack-weights-") as folder:
        refuse_earlier_run(settings.out)
        note(f"{path}: waiting until it holds enough to begin")
        followed = Following(settings, path, watch or FileWatch(path, settings.idle_timeout_s), Path(folder))
        try:
            yield followed
        finally:
            followed.abandon()


class Following:
    """One recording, followed by all trackers at the same time: first `follow`, then `finish`."""

    def __init__(self, settings: CompareSettings, path: Path, watch: FileWatch, folder: Path) -> None:
        """`folder`: for copies of the weights."""
        self.interrupted = False
        """Whether Ctrl-C ended the recording."""
        self._watch, self._path = watch, path
        self._recording = open_growing(path, settings, watch.more)
        assert self._recording.growth is not None
        self._growth: Growth = self._recording.growth
        self._sampling = sampling_of(settings)
        validation, form = settings.validation, settings.format
        self._validation = open_recording(parse_stretch(validation)[0], format=form) if validation else None
        self._split = self._split_of(settings)
        self._plan = with_copied_weights(resolve(settings, (self._split,)), folder)
        refuse_raw(self._plan.trials)
        self.pace = RealTimePace(self._split.test.period_s)
        self._arrivals = Arrivals(self._split.test, self._growth)
        shared, moments = SharedThresholds(folder), self._validation_moments()
        self.runs = [
            FollowedTrial(trial, moments, settings.out / trial.name, partial(self._next_frame, trial.name), shared)
            for trial in self._plan.trials
        ]
        self._threads = [threading.Thread(target=self._run, args=(run,), name=run.trial.name) for run in self.runs]
        self._scores = LiveScores(self._split, self.runs)
        self._advanced: Callable[[str], None] | None = None
        self._stop = threading.Event()
        self._records: dict[str, TrialRecord] = {}
        self._digest = hashlib.blake2b(digest_size=16)
        self._frames = self._frames_before = 0
        self._newest: Arrival | None = None
        self._begun_bytes = 0

    def follow(self, table: LiveObserver) -> None:
        """Present the frames to the trackers as they are written, up to the end of the file or Ctrl-C."""
        for kind in by_kind(self._plan.notices, [self._split.name]):
            table.note(kind.text)
        try:
            table.note(f"{self._path}: starting {len(self.runs)} trackers")
            self._start()
            table.note(f"{self._path}: following; end with Ctrl-C")
            for arrival in self._arrivals:
                self._present(arrival)
                table.update(self._status)
                if all(run.live.left for run in self.runs):
                    break
            self._await_next(has_deadline=self._frames > self._frames_before, behind=True)
        except KeyboardInterrupt:
            self.interrupted = True
        finally:
            self._watch.stop()
            self._arrivals.stop()
        self._close_deadline()
        for run in self.runs:
            run.live.end()
        self._scores.stop()

    def finish(self, command: Sequence[str], progress: RunObserver) -> RunSummary:
        """Score the forecasts that were in time, and return the summary; `command` is stored with the results.

        A second Ctrl-C keeps the scores so far. Raises RecordingError if there is nothing to score.
        """
        plan = self._whole_plan()
        with engine_of(plan.settings, progress) as engine:
            return self._finish(plan, command, progress, engine)

    def abandon(self) -> None:
        """End everything that still runs."""
        self._stop.set()
        self._watch.stop()
        self._arrivals.stop()
        self._scores.stop()
        for run, thread in zip(self.runs, self._threads, strict=True):
            if thread.is_alive():
                run.abandon()
                thread.join()

    def _finish(
        self, plan: ComparisonPlan, command: Sequence[str], progress: RunObserver, engine: Engine
    ) -> RunSummary:
        folder = RunFolder.prepare(plan, command)
        stages = Stages(plan, folder.path, progress, engine)
        interrupted = False
        try:
            self._score(plan, progress)
        except KeyboardInterrupt:
            interrupted = True
            self.abandon()
        self._join()
        stages.keep(self._records)
        if not interrupted:
            try:
                stages.score_missing()
            except KeyboardInterrupt:
                interrupted = True
        return folder.finish(stages.all_records(), [*stages.notices, *self._notices()], interrupted)

    def _start(self) -> None:
        self._scores.start()
        for thread in self._threads:
            thread.start()
        for run in self.runs:
            while not run.ready.wait(WAKE_S):
                pass
        self._begun_bytes = self._path.stat().st_size
        self._growth.more = self._watch.more

    def _present(self, arrival: Arrival) -> None:
        """Present the next frame at its time, when the deadline of the previous one has passed."""
        frame, has_deadline = arrival.observation.frame, arrival.position > self._begun_bytes
        self._await_next(has_deadline=has_deadline, behind=self._arrivals.behind_s(frame.stamp_ns) > BEHIND_S)
        self._close_deadline()
        for run in self.runs:
            run.live.present(frame, has_deadline=has_deadline)
        self._digest.update(frame_digest(frame))
        self._newest, self._frames = arrival, self._frames + 1
        self._frames_before += not has_deadline

    def _await_next(self, *, has_deadline: bool, behind: bool) -> None:
        """Wait until it is time for the next frame: without a deadline, until every tracker is free."""
        if has_deadline:
            self.pace.wait(self._all_free, behind=behind)
            return
        while not self._all_free(WAKE_S):
            pass
        self.pace.restart()

    def _all_free(self, timeout_s: float) -> bool:
        """Wait until every tracker is free, for at most `timeout_s`. Returns True if all are."""
        end_s = time.monotonic() + timeout_s
        return all(run.live.wait_until_free(max(0.0, end_s - time.monotonic())) for run in self.runs)

    def _close_deadline(self) -> None:
        if self._newest is None:
            return
        for run in self.runs:
            run.close_deadline(self._frames - 1)
        self._scores.add(self._newest.observation)
        self._newest = None

    def _status(self) -> LiveStatus:
        period_s = self._split.test.period_s
        at_ns = self._recording.survey.first_ns + (self._frames - 1) * self._split.test.period_ns
        score = f"F1 dynamic at {self._scores.step * period_s:g} s"
        return LiveStatus((self._frames - 1) * period_s, self._arrivals.behind_s(at_ns), score, self._scores.rows())

    def _run(self, run: FollowedTrial) -> None:
        """Run a trial in its thread; an error outside its tracker stops no other trial."""
        try:
            self._records[run.trial.name] = run.run()
        except Interrupted:
            return
        except Exception as error:  # noqa: BLE001 the other trials continue
            self._records[run.trial.name] = failed(run.trial, error_with_location(error))

    def _next_frame(self, name: str) -> None:
        if self._stop.is_set():
            raise Interrupted
        if self._advanced is not None:
            self._advanced(name)

    def _split_of(self, settings: CompareSettings) -> EvaluationSplit:
        name = name_from(self._path)
        return split_of(self._recording, name, None, settings.validation, self._sampling, self._validation)

    def _validation_moments(self) -> SplitMoments:
        """The moments with the regions of the validation stretch; the test stretch gets its regions at its end."""
        stretch = self._split.validation or self._split.test
        regions = regions_of(stretch, self._split.strata)
        return self._split.moments(SplitRegions(regions, regions))

    def _whole_plan(self) -> ComparisonPlan:
        """The plan for the frames that were presented. Raises RecordingError if there are too few."""
        growth = self._growth
        growth.more = Growth().more
        if growth.cut or not self._arrivals.ended:
            growth.limit = growth.position
        self._recording.survey_again()
        test = self._split.test
        sampling = replace(self._sampling, grid=test.grid, rate_hz=1e9 / test.period_ns)
        settings = self._plan.settings
        arguments = settings.validation, sampling, self._validation
        split = split_of(self._recording, name_from(self._path), None, *arguments)
        all_left = all(run.live.left for run in self.runs)
        if self._frames < len(split.test) and not (all_left and self._frames <= WARM_UP + split.steps):
            if self._frames <= WARM_UP + split.steps:
                raise RecordingError(
                    f"{self._path}: ended after {self._frames} frames, which leave nothing to score after {WARM_UP} of"
                    f" warm-up and with {split.steps} steps ahead"
                )
            stretch = 0.0, self._frames * test.period_ns / 1e9
            split = split_of(self._recording, name_from(self._path), stretch, *arguments)
        trials = tuple(replace(trial, split=split) for trial in self._plan.trials)
        others = (notice for notice in self._plan.notices if notice not in self._split.notices)
        notices = dict.fromkeys((*split.notices, *others))
        return ComparisonPlan(settings, (split,), trials, tuple(notices))

    def _score(self, plan: ComparisonPlan, progress: RunObserver) -> None:
        progress.note(f"{self._path}: ended; scoring the forecasts that were in time")
        (split,) = plan.splits
        moments = split.moments(split.regions())
        progress.planned({trial.name: len(trial.test) for trial in plan.trials})
        for trial in plan.trials:
            progress.started(trial.name, len(trial.test))
        self._advanced = progress.advanced
        for run, trial in zip(self.runs, plan.trials, strict=True):
            run.score(trial, moments)
        self._join()

    def _join(self) -> None:
        for thread in self._threads:
            while thread.is_alive():
                thread.join(WAKE_S)

    def _notices(self) -> list[Notice]:
        """The notices of the run."""
        records = self._records.values()
        of_trials = (Notice(text=text, row=record.label) for record in records for text in self._about_a_trial(record))
        return [*(Notice(text=text) for text in self._about_the_end()), *of_trials]

    def _about_the_end(self) -> Iterator[str]:
        path, before = self._path, self._frames_before
        ended = f"{path}: ended at {self._frames * self._split.test.period_s:.1f} s"
        if before:
            yield f"{path}: the first {before} frames, written before the comparison began, have no deadline"
        if self._arrivals.problem:
            yield f"{ended}: {self._arrivals.problem}"
        elif self.interrupted:
            yield f"{ended} by Ctrl-C"
        elif self._watch.idle:
            yield f"{ended}: nothing was written to it for --idle-timeout"
        if self._growth.limit is not None:
            yield f"{path}: its recorder had not closed it: its first {self._growth.limit} bytes were read"
        if self._scores.problem:
            yield f"the live table lacks scores: {self._scores.problem}"

    def _about_a_trial(self, record: TrialRecord) -> Iterator[str]:
        followed = record.followed
        if followed and followed.missed and followed.age_frames:
            yield (
                f"missed {followed.missed} of {followed.frames} frames with a deadline; its newest forecast"
                f" in time was {followed.age_frames.p99:g} frames old at the 99th percentile"
            )
        if record.complete and record.delivered != self._digest.hexdigest():
            yield "received other frames than it was scored on"
