"""One trial: a tracker in its process, streamed a validation and then a test stretch, scored as it goes."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from gridtrack.common.errors import RecordingError
from gridtrack.evaluation.comparison.plan import Trial
from gridtrack.evaluation.comparison.shared_thresholds import SharedThresholds
from gridtrack.evaluation.processes.outcome import TrialEnded
from gridtrack.evaluation.processes.tracker_process import Started, TrackerProcess
from gridtrack.evaluation.scoring.counting import Tally, count_forecast
from gridtrack.evaluation.scoring.record import RECORD, Ending, ThresholdsUsed, Times, TrialRecord
from gridtrack.evaluation.scoring.referee import Delivery, scored_forecasts
from gridtrack.evaluation.scoring.scorekeeper import SCORE_FILES, Scorekeeper
from gridtrack.evaluation.scoring.scores import HISTOGRAM, SCORES
from gridtrack.evaluation.scoring.splits import SplitRegions
from gridtrack.evaluation.scoring.thresholds import Thresholds, best_thresholds, half
from gridtrack.trackers.contract import stream_of

STDERR = "stderr.log"
INTERRUPTED_REASON = "the run was interrupted; continue it with --resume"
OnFrame = Callable[[], None]
"""Called before each frame is delivered; it raises Interrupted to stop the trial."""


class Interrupted(Exception):
    """The run was interrupted: what the trial has scored is kept."""


class TrialRun:
    """A trial while it runs: how far it has come is what its record tells when it ends early."""

    def __init__(
        self, trial: Trial, regions: SplitRegions, folder: Path, on_frame: OnFrame, shared: SharedThresholds
    ) -> None:
        """`regions` as of `trial.split.regions`; the trial's files are left in `folder`.

        `shared` holds the thresholds that trials before this one have chosen in the same run.
        """
        folder.mkdir(parents=True, exist_ok=True)
        for left_by_an_earlier_attempt in (RECORD, *SCORE_FILES):
            (folder / left_by_an_earlier_attempt).unlink(missing_ok=True)
        self.trial, self._regions, self._folder, self._on_frame = trial, regions, folder, on_frame
        self._shared = shared
        self._thresholds: Thresholds | None = None
        self._test = trial.split.schedule
        self._delivery = Delivery(trial.test, on_frame)
        self._scored = 0
        self._started: Started | None = None
        self._start_s = self._wall_s = 0.0
        self._interrupted = False
        self._process = TrackerProcess(
            trial.launch,
            stream_of(trial.test, trial.weights.path if trial.weights else None),
            trial.selection.options,
            trial.limits,
            folder / STDERR,
        )

    def run(self) -> TrialRecord:
        """Run to the end, whatever that is, and write the record."""
        ending, reason = self._run()
        if self._interrupted and ending != "ok":
            ending, reason = "interrupted", INTERRUPTED_REASON
        record = self._record(ending, reason)
        record.write(self._folder)
        return record

    def _run(self) -> tuple[Ending, str]:
        """Run, and say how it ended and why."""
        began = time.perf_counter()
        try:
            with self._process:
                self._start_s = time.perf_counter() - began
                self._started = self._process.started
                self._thresholds = self._shared.of(self.trial, self._choose_thresholds)
                with self._clock():
                    self._score(self._thresholds)
        except TrialEnded as ended:
            return ended.outcome, self.trial.how_to_train if ended.outcome == "untrained" else ended.reason
        except Interrupted:
            return "interrupted", INTERRUPTED_REASON
        except RecordingError as error:
            return "not-applicable", str(error)
        except Exception as error:  # noqa: BLE001 a full disk, a mistake in the scoring: the other trials go on
            return "failed", where_it_failed(error)
        return "ok", ""

    @contextmanager
    def _clock(self) -> Iterator[None]:
        """Add the time of what is done inside, however it ends."""
        began = time.perf_counter()
        try:
            yield
        finally:
            self._wall_s += time.perf_counter() - began

    @property
    def frames(self) -> int:
        """How many frames the trial delivers, on both stretches."""
        validation = () if self._shared.known(self.trial) else self.trial.validation or ()
        return len(self.trial.test) + len(validation)

    def interrupt(self) -> None:
        """End the trial from another thread, also in the middle of a call."""
        self._interrupted = True
        self._process.kill()

    def _choose_thresholds(self) -> Thresholds:
        """Stream the validation stretch and choose each step's threshold by it; 0.5 where there is none."""
        stretch = self.trial.validation
        if stretch is None:
            return half(self.trial.split.steps, self.trial.split.strata)
        tally = Tally.empty(self.trial.split.steps, self.trial.split.strata)
        delivery, region_maps = Delivery(stretch, self._on_frame), self._regions.validation
        try:
            with self._clock():
                for scored in scored_forecasts(
                    self._process, delivery, self.trial.split.validation_schedule, self.trial.seed
                ):
                    tally.add(count_forecast(scored.forecast.occupancy, scored.targets, region_maps, scored.ages))
        except TrialEnded as ended:
            raise TrialEnded(ended.outcome, f"in the validation stretch {stretch.name}: {ended.reason}") from None
        return best_thresholds(tally, stretch.name)

    def _score(self, thresholds: Thresholds) -> None:
        """Stream the test stretch, and write what each forecast scored as soon as its last frame has come."""
        split, region_maps = self.trial.split, self._regions.test
        with Scorekeeper(self._folder, split, region_maps, thresholds, self._process.started.classes) as scorekeeper:
            for scored in scored_forecasts(self._process, self._delivery, self._test, self.trial.seed):
                scorekeeper.add(scored, self._delivery.digest)
                self._scored = scorekeeper.scored

    def _kept_whole(self) -> bool:
        """Whether what was scored lies in whole files: a disk may be full before the last is written."""
        return all((self._folder / name).is_file() for name in (SCORES, HISTOGRAM))

    def _record(self, ending: Ending, reason: str) -> TrialRecord:
        chosen = self._thresholds or half(self.trial.split.steps, self.trial.split.strata)
        timings = self._process.timings
        return unstarted(self.trial).model_copy(
            update={
                "outcome": ending,
                "reason": reason,
                "frames_scored": self._scored if self._kept_whole() else 0,
                "frames_delivered": self._delivery.frames,
                "delivered": self._delivery.digest,
                "thresholds": ThresholdsUsed.of(chosen),
                **self._description(),
                "times": Times(
                    start_s=self._start_s,
                    update_s=timings.update.total_ms / 1000,
                    predict_s=timings.predict.total_ms / 1000,
                    wall_s=self._wall_s,
                    frames=len(timings.update),
                ),
                "recoveries": self._process.recoveries,
                "peak_rss_mb": self._process.peak_rss_mb,
            }
        )

    def _description(self) -> dict[str, Any]:
        """The fields of the record that the tracker reports of itself; the defaults where it did not start."""
        started = self._started
        if started is None:
            return {}
        reference_for = tuple(sorted(started.reference_for))
        return {"classes": started.classes, "role": started.role, "reference_for": reference_for}


def unstarted(trial: Trial) -> TrialRecord:
    """The record of a trial that an interrupt kept from starting."""
    return TrialRecord(
        label=trial.label,
        recording=trial.split.name,
        outcome="interrupted",
        reason=INTERRUPTED_REASON,
        frames_expected=trial.split.schedule.expected,
        steps=trial.split.steps,
        weights_sha256=trial.weights.sha256 if trial.weights else "",
    )


def failed(trial: Trial, error: Exception) -> TrialRecord:
    """The record of a trial that could not even leave one."""
    return unstarted(trial).model_copy(update={"outcome": "failed", "reason": where_it_failed(error)})


def where_it_failed(error: Exception) -> str:
    """An error that nobody foresaw, and the line of code that it comes from, in one line."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    words = " ".join(str(error).split())
    return f"{type(error).__name__}: {words} ({Path(last.filename).name}, line {last.lineno})"
