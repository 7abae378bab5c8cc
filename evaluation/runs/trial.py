"""One trial: a tracker in its own process, streamed a validation and then a test stretch, scored frame by frame."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from gridtrack.common.errors import RecordingError, bounded_line
from gridtrack.common.files import remove_partial_files
from gridtrack.common.forecast_file import open_forecasts
from gridtrack.evaluation.engines.engine import Interrupted
from gridtrack.evaluation.hosting.outcome import TrialEnded
from gridtrack.evaluation.hosting.timing import Timings
from gridtrack.evaluation.hosting.tracker_process import TrackerDescription
from gridtrack.evaluation.referee.referee import Delivery, TrackerLike, refuse_moving, scored_forecasts
from gridtrack.evaluation.referee.splits import EvaluationSplit, SplitMoments
from gridtrack.evaluation.runs.passes import RoundTrips
from gridtrack.evaluation.runs.plan import Trial
from gridtrack.evaluation.runs.prior import PRIOR_FILE, PriorRecorder, has_prior
from gridtrack.evaluation.runs.scorekeeper import SCORE_FILES, Scorekeeper, facts_of
from gridtrack.evaluation.runs.shared_thresholds import SharedThresholds, thresholds_of_card, trial_key
from gridtrack.evaluation.runs.sums import SUMS_FILE
from gridtrack.evaluation.runs.trial_record import (
    MOST_MISSING,
    OUTCOME_FILE,
    ThresholdsUsed,
    Times,
    TrialEnding,
    TrialRecord,
    hashes_of,
)
from gridtrack.evaluation.scores.cells import Tally, count_cells
from gridtrack.evaluation.scores.registry import scores
from gridtrack.evaluation.scores.thresholds import LABEL_FREE, Thresholds, best_thresholds, half

STDERR_LOG = "stderr.log"
RESULT_FILES = (*SCORE_FILES, PRIOR_FILE)
REPLACED = (OUTCOME_FILE, *RESULT_FILES)
"""Files of an earlier run that a trial replaces."""
INTERRUPTED_REASON = "the run was interrupted; continue it with --resume"
OnFrame = Callable[[], None]
"""Called before each frame is delivered; it raises Interrupted to stop the trial."""


class TrialRun:
    """A trial while it runs. A trial that ends early leaves a record of the frames scored until then."""

    def __init__(
        self, trial: Trial, moments: SplitMoments, folder: Path, on_frame: OnFrame, shared: SharedThresholds
    ) -> None:
        """`moments` of `trial.test` and `trial.validation`; the trial's files are written to `folder`.

        `shared` holds the thresholds that earlier trials of the same run have chosen.
        """
        folder.mkdir(parents=True, exist_ok=True)
        remove_partial_files(folder)
        for stale in REPLACED:
            (folder / stale).unlink(missing_ok=True)
        self.trial, self._moments, self._folder, self._on_frame = trial, moments, folder, on_frame
        self._shared = shared
        self._thresholds: Thresholds | None = None
        self._prior: PriorRecorder | None = None
        self._test = trial.split.schedule
        self._delivery = Delivery(moments.test, on_frame)
        self._scored = self._missing = 0
        self._description: TrackerDescription | None = None
        self._start_s = self._wall_s = 0.0
        self._interrupted = False
        self._process = trial.tracker_process(folder / STDERR_LOG, scored=True)

    def run(self) -> TrialRecord:
        """Run until the trial ends, successfully or not, and write the record."""
        ending, reason = self._run()
        if self._interrupted and ending != "ok":
            ending, reason = "interrupted", INTERRUPTED_REASON
        record = self._record(ending, reason)
        record.write(self._folder)
        return record

    def _run(self) -> tuple[TrialEnding, str]:
        """Run; the ending and its reason."""
        began = time.perf_counter()
        try:
            with self._process:
                self._start_s = time.perf_counter() - began
                self._description = self._process.description
                self._refuse_moving(self._description)
                self._prior = self._expectation()
                self._thresholds = self._shared.of(trial_key(self.trial), self._choose_thresholds)
                with self._clock():
                    self._score(self._thresholds)
        except TrialEnded as ended:
            untrained = ended.outcome == "untrained"
            return ended.outcome, self.trial.how_to_train if untrained else self.trial.with_original_paths(ended.reason)
        except Interrupted:
            return "interrupted", INTERRUPTED_REASON
        except RecordingError as error:
            return "not-applicable", str(error)
        except Exception as error:  # noqa: BLE001 a full disk or a defect in the scoring must not stop the other trials
            return "failed", error_with_location(error)
        if self._missing > MOST_MISSING * self._test.expected:
            return "ok", f"{self._missing} of {self._test.expected} frames have no recorded forecast"
        return "ok", ""

    def _refuse_moving(self, description: TrackerDescription) -> None:
        """Raise RecordingError if the sensor moves and the tracker cannot follow it."""
        if not description.moving_sensor:
            for stretch in filter(None, (self.trial.validation, self.trial.test)):
                refuse_moving(stretch, self.trial.label)

    def _expectation(self) -> PriorRecorder | None:
        """The tracker's expectation of the place: it is asked now, because later it could remember frames."""
        if not has_prior(self.trial):
            return None
        prior = PriorRecorder(self._process, self.trial)
        self._process.timings = Timings()  # of the stretches alone
        return prior

    @contextmanager
    def _clock(self) -> Iterator[None]:
        """Add the duration of the block to the wall time, also when it raises."""
        began = time.perf_counter()
        try:
            yield
        finally:
            self._wall_s += time.perf_counter() - began

    @property
    def frames(self) -> int:
        """Number of frames that the trial will deliver, on both stretches."""
        validation = () if self._shared.known(trial_key(self.trial)) else self.trial.validation or ()
        return len(self.trial.test) + len(validation)

    def interrupt(self) -> None:
        """End the trial from another thread, also during a call."""
        self._interrupted = True
        self._process.kill()

    def _choose_thresholds(self) -> Thresholds:
        """Stream the validation stretch and choose the thresholds on it.

        Without such a stretch they come from the card, and are 0.5 if it has none. Recorded forecasts without one, or
        with none there, have label-free thresholds.
        """
        moments = self._moments.validation
        if moments is None:
            return thresholds_of_card(self.trial) or self._unchosen()
        delivery, stretch = Delivery(moments, self._on_frame), moments.stream
        try:
            with self._clock():
                tally = validation_tally(self._process, delivery, self.trial.split, self.trial.seed)
        except TrialEnded as ended:
            raise TrialEnded(ended.outcome, f"in the validation stretch {stretch.name}: {ended.reason}") from None
        return best_thresholds(tally, stretch.name) if tally.cells.any() else self._unchosen()

    def _unchosen(self) -> Thresholds:
        """The thresholds that nothing was chosen on."""
        split = self.trial.split
        found = half(split.steps, split.strata)
        return replace(found, chosen_on=LABEL_FREE) if self._process.description.role == "recorded" else found

    def _score(self, thresholds: Thresholds) -> None:
        """Stream the test stretch and write the score of each forecast once its last frame is observed."""
        split = self.trial.split
        facts = facts_of(split, thresholds, self.trial.robot, self._process.description.classes)
        delivered = self._delivery if self._prior is None else self._prior.counted(self._delivery)
        with Scorekeeper(self._folder, split, facts, scores(self.trial.scores)) as scorekeeper:
            for scored in scored_forecasts(self._tracker(), delivered, self._test, self.trial.seed):
                if scored.missing:
                    self._missing += 1
                    continue
                scorekeeper.add(scored, self._delivery.digest)
                self._scored = scorekeeper.scored
        if self._prior is not None:
            self._prior.write(self._folder)

    def _tracker(self) -> TrackerLike:
        """The forecaster of the test stretch."""
        return self._process

    def _has_scores(self) -> bool:
        """Whether the sums are complete: the disk may be full before they are written."""
        return (self._folder / SUMS_FILE).is_file()

    def _record(self, ending: TrialEnding, reason: str) -> TrialRecord:
        chosen = self._thresholds or half(self.trial.split.steps, self.trial.split.strata)
        timings = self._process.timings
        update_ms, predict_ms = timings.counted_ms()
        return unstarted(self.trial).model_copy(
            update={
                "outcome": ending,
                "reason": reason,
                "frames_scored": self._scored if self._has_scores() else 0,
                "frames_missing": self._missing,
                "frames_delivered": self._delivery.frames,
                "delivered": self._delivery.digest,
                "thresholds": ThresholdsUsed.of(chosen),
                **self._reported_fields(),
                "times": Times(
                    start_s=self._start_s,
                    update_s=float(update_ms.sum()) / 1000,
                    predict_s=float(predict_ms.sum()) / 1000,
                    wall_s=self._wall_s,
                    frames=len(timings.updates),
                ),
                "round_trips": RoundTrips.of(timings),
                "recoveries": self._process.recoveries,
                "files": hashes_of(self._folder, RESULT_FILES),
                "peak_rss_mb": self._process.peak_rss_mb,
            }
        )

    def _reported_fields(self) -> dict[str, Any]:
        """The fields of the record that the tracker reports of itself; the defaults if it did not start."""
        description = self._description
        if description is None:
            return {}
        reference_for = tuple(sorted(description.reference_for))
        return {
            "classes": description.classes,
            "role": description.role,
            "reference_for": reference_for,
            "code_sha256": description.code_sha256,
        }


def validation_tally(tracker: TrackerLike, delivery: Delivery, split: EvaluationSplit, seed: int) -> Tally:
    """The counts of `tracker` on the validation stretch of `split`, which `delivery` delivers."""
    tally = Tally.empty(split.steps, split.strata)
    for scored in scored_forecasts(tracker, delivery, split.validation_schedule, seed):
        if scored.missing:
            continue
        tally.add(count_cells(scored.occupancy, scored.targets, scored.region_maps, scored.ages))
    return tally


def unstarted(trial: Trial) -> TrialRecord:
    """The record of a trial that did not start because of an interrupt."""
    return TrialRecord(
        label=trial.label,
        recording=trial.split.name,
        outcome="interrupted",
        reason=INTERRUPTED_REASON,
        frames_expected=trial.split.schedule.expected,
        steps=trial.split.steps,
        weights_sha256=trial.weights.sha256 if trial.weights else "",
        card=trial.weights.kind if trial.weights else "",
        leak="; ".join(trial.leaks),
        may_remember=trial.is_users and not trial.limits.sandbox,
        made_by=open_forecasts(trial.recorded).note if trial.recorded else "",
    )


def failed(trial: Trial, reason: str) -> TrialRecord:
    """The record of a trial that could not write one."""
    return unstarted(trial).model_copy(update={"outcome": "failed", "reason": reason})


def error_with_location(error: Exception) -> str:
    """An unexpected error with the file and line that raised it, as one line of text."""
    origin = traceback.extract_tb(error.__traceback__)[-1]
    words = " ".join(str(error).split())
    return bounded_line(f"{type(error).__name__}: {words} ({Path(origin.filename).name}, line {origin.lineno})")
