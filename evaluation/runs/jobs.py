"""The jobs of a run: the scores of a trial or of the oracle, and the measurements that follow the scores.

A job can be sent to a process on another machine as an order, in JSON. The order names recordings, weights and programs
by their paths, which host and machine share, with their hashes: a machine that finds another recording, card or library
there refuses the job.
"""

from __future__ import annotations

import platform
import threading
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from gridtrack.common.config import Settings
from gridtrack.common.errors import GridtrackError
from gridtrack.common.files import name_from
from gridtrack.common.grid import Points
from gridtrack.common.notices import Notice
from gridtrack.evaluation.engines.engine import EngineError, Monitor
from gridtrack.evaluation.engines.task import TaskFolder, run_task
from gridtrack.evaluation.hosting.outcome import TrialEnded
from gridtrack.evaluation.referee.splits import EvaluationSplit, SplitMoments, SplitRegions, plan_split
from gridtrack.evaluation.runs.conditions import measure_robustness
from gridtrack.evaluation.runs.learned import read_weights
from gridtrack.evaluation.runs.oracle import ORACLE_REPLACES, oracle_validation, run_oracle
from gridtrack.evaluation.runs.plan import Trial, sampling_of, segmented
from gridtrack.evaluation.runs.recorded_rows import hash_of_file
from gridtrack.evaluation.runs.run_folder import versions
from gridtrack.evaluation.runs.run_record import RecordingIdentity, TrialIdentity, identity_of
from gridtrack.evaluation.runs.settings import CompareSettings
from gridtrack.evaluation.runs.shared_thresholds import SharedThresholds, oracle_key, trial_key
from gridtrack.evaluation.runs.trial import REPLACED, STDERR_LOG, TrialRun, error_with_location, failed
from gridtrack.evaluation.runs.trial_record import OUTCOME_FILE, TrialRecord, read_trial_record
from gridtrack.evaluation.scores.registry import scores
from gridtrack.recordings.stretches import parse_stretch
from gridtrack.trackers import registry
from gridtrack.trackers.selection import Launch, Selection, launch


class SharedInputs:
    """The settings of a run, and regions, moments and thresholds, made by the first job that needs them.

    Thread-safe. `note` receives a line for the user where that takes a while.
    """

    def __init__(self, settings: CompareSettings, note: Callable[[str], None], folder: Path, jobs: int = 1) -> None:
        """`folder`: of `SharedThresholds`; `jobs` run at the same time.

        Regions and moments are kept of as many recordings: they are many megabytes, and a run may have thousands of
        recordings.
        """
        self.settings, self.folder = settings, folder
        self.thresholds = SharedThresholds(folder)
        self._note, self._jobs = note, jobs
        self._guard = threading.Lock()
        self._regions: dict[str, Future[SplitRegions]] = {}
        """By the name of the whole split, the last used at the end."""
        self._moments: dict[tuple[str, Points], SplitMoments] = {}
        """By the name of the split, the last used at the end."""

    def moments_of(
        self, split: EvaluationSplit, points: Points = "centres", check: Callable[[], None] = lambda: None
    ) -> SplitMoments:
        """The moments of a split with the returns `points`; otherwise as `regions_of`."""
        regions, key = self.regions_of(split, check), (split.name, points)
        with self._guard:
            found = self._moments.pop(key, None) or split.moments(regions, points)
            self._moments[key] = found
            while len(self._moments) > self._jobs:
                del self._moments[next(iter(self._moments))]
        return found

    def regions_of(self, split: EvaluationSplit, check: Callable[[], None] = lambda: None) -> SplitRegions:
        """The regions of a split; finding them calls `check()` now and then. Raises its errors, RecordingError."""
        with self._guard:
            known = self._regions.pop(split.whole, None)
            found = self._regions[split.whole] = known or Future()
            while len(self._regions) > self._jobs:
                del self._regions[next(iter(self._regions))]
        if known is None:
            self._find(split, found, check)
        return found.result()

    def _find(self, split: EvaluationSplit, found: Future[SplitRegions], check: Callable[[], None]) -> None:
        """Set the regions of a split, or the error for all jobs that wait for them."""
        self._note(f"{split.whole}: finding its static cells")
        try:
            found.set_result(split.regions(check))
        except Exception as error:  # noqa: BLE001 all jobs that wait for the regions raise it
            found.set_exception(error)


class _RunJob:
    """A job with the name of a trial; its result is the record in the trial's folder."""

    replaces: tuple[str, ...] = ()
    result_file = OUTCOME_FILE
    record: TrialRecord | None = None
    """The record to which a measurement is added."""

    def __init__(self, name: str, subject: Trial | EvaluationSplit, folder: Path, shared: SharedInputs) -> None:
        """`folder`: the folder for the files of the trial."""
        self.name = name
        self._subject, self._folder, self._shared = subject, folder, shared
        self._end: Callable[[], None] | None = None
        self._interrupted = False

    def order(self) -> str:
        """Its description as JSON."""
        return JobOrder.of(self._subject, self._shared, self.record).model_dump_json(by_alias=True)

    def result(self) -> TrialRecord:
        """The record in the trial's folder. Raises EngineError without one, RunError."""
        record = read_trial_record(self._folder)
        if record is None:
            raise EngineError(f"it left no {OUTCOME_FILE}")
        return record

    def interrupt(self) -> None:
        """End it from another thread, also before it has begun."""
        self._interrupted = True
        if self._end is not None:
            self._end()

    def _begin(self, end: Callable[[], None]) -> None:
        """From now on an interrupt calls `end()`."""
        self._end = end
        if self._interrupted:
            end()


class TrialJob(_RunJob):
    """The scores of a trial. An error outside its tracker gives the outcome `failed`."""

    replaces = REPLACED

    def __init__(self, trial: Trial, folder: Path, shared: SharedInputs) -> None:
        super().__init__(trial.name, trial, folder, shared)
        self.trial, self.split, self.validation = trial, trial.split, trial.split.validation
        self._started_before = (folder / STDERR_LOG).is_file()

    @property
    def thresholds_key(self) -> str:
        """Identifies its thresholds in the run."""
        return trial_key(self.trial)

    def run(self, monitor: Monitor) -> TrialRecord:
        """Run the trial to its end, successful or not."""
        moments = self._shared.moments_of(self.split, self.trial.selection.points, monitor.check)
        run = TrialRun(self.trial, moments, self._folder, monitor.next_frame, self._shared.thresholds)
        monitor.started(run.frames)
        self._begin(run.interrupt)
        return run.run()

    def on_error(self, error: Exception) -> TrialRecord:
        """The record of a trial that could not write one."""
        return self._write_if_possible(failed(self.trial, _reason(error)))

    def accepted(self, record: TrialRecord) -> TrialRecord:
        """`record` with the facts that another machine does not know: advice on training for the whole run, and whether
        the tracker was started before. A changed record is written again.
        """
        known: dict[str, Any] = {"started_before": record.may_remember and self._started_before}
        if record.outcome == "untrained":
            known["reason"] = self.trial.how_to_train
        changed = record.model_copy(update=known)
        return record if changed == record else self._write_if_possible(changed)

    def _write_if_possible(self, record: TrialRecord) -> TrialRecord:
        with suppress(OSError):
            self._folder.mkdir(parents=True, exist_ok=True)
            record.write(self._folder)
        return record


class OracleJob(_RunJob):
    """The scores of the oracle on one recording; if that fails, the run continues without it."""

    replaces = ORACLE_REPLACES

    def __init__(self, split: EvaluationSplit, folder: Path, shared: SharedInputs) -> None:
        super().__init__(split.oracle_name, split, folder, shared)
        self.split, self.validation = split, oracle_validation(split)

    @property
    def thresholds_key(self) -> str:
        """Identifies its thresholds in the run."""
        return oracle_key(self.split)

    def run(self, monitor: Monitor) -> TrialRecord:
        """Score the oracle. Raises Interrupted: it waits for no other process, so the next frame ends it."""
        split, thresholds = self.split, self._shared.thresholds
        validation = () if thresholds.known(self.thresholds_key) else self.validation or ()
        monitor.started(len(split.test) + len(validation))
        moments, by = self._shared.moments_of(split, check=monitor.check), scores(self._shared.settings.scores)
        return run_oracle(split, moments, self._folder, monitor.next_frame, thresholds, by, self._shared.settings.robot)

    def on_error(self, error: Exception) -> Notice:
        """The notice for the user."""
        return Notice(text=f"no oracle: {_reason(error)}", recording=self.split.name, kind="no oracle")


class RobustnessJob(_RunJob):
    """The scores of a trial on the degraded input that the settings of the run request, added to its record."""

    record: TrialRecord

    def __init__(self, trial: Trial, record: TrialRecord, folder: Path, shared: SharedInputs) -> None:
        super().__init__(trial.name, trial, folder, shared)
        self.trial, self.split, self.record = trial, trial.split, record

    def run(self, monitor: Monitor) -> TrialRecord:
        """Run the pass. Raises Interrupted, TrialEnded."""
        monitor.note(f"{self.name}: degraded input")
        degradation = self._shared.settings.degrade
        assert degradation is not None, "the run requests no degraded input"
        test = self._shared.moments_of(self.split, self.trial.selection.points, monitor.check).test
        trial, record, folder = self.trial, self.record, self._folder
        found = measure_robustness(trial, degradation, test, record, folder, monitor.check, self._begin)
        record = record.model_copy(update={"robustness": found})
        record.write(self._folder)
        return record

    def on_error(self, error: Exception) -> Notice:
        """The notice for the user."""
        return not_measured(self.trial, "degraded input", error)


RunJob = TrialJob | OracleJob | RobustnessJob


def not_measured(trial: Trial, measurement: str, error: Exception) -> Notice:
    """The notice about a missing measurement of a complete trial."""
    missing = f"no measurement of {measurement}"
    return trial.notice(f"{missing}: {_reason(error)}", missing)


def _reason(error: Exception) -> str:
    return str(error) if isinstance(error, TrialEnded | GridtrackError) else error_with_location(error)


class RowOrder(Settings):
    """A row of the comparison on one recording: the tracker, its program, and its weights."""

    selection: Selection
    launch: Launch
    """A registered tracker is started by each machine as its own."""
    weights: Path | None
    weights_from: Path | None
    """The folder that the weights were copied from, for messages."""
    weights_sha256: str
    identity: TrialIdentity
    """The trial must have this identity on the machine."""

    @classmethod
    def of(cls, trial: Trial) -> RowOrder:
        """The row of a trial."""
        weights = trial.weights
        return cls(
            selection=trial.selection,
            launch=trial.launch,
            weights=weights and weights.path.absolute(),
            weights_from=weights and weights.original.absolute(),
            weights_sha256=weights.sha256 if weights else "",
            identity=trial.identity(),
        )

    def trial(self, split: EvaluationSplit, settings: CompareSettings) -> Trial:
        """The trial on this machine. Raises a GridtrackError if it is a different one here."""
        start = self.launch if self.launch.external else launch(self.selection.name)
        weights = read_weights(self.weights, self.weights_from or self.weights.parent) if self.weights else None
        trial = Trial(
            self.selection,
            start,
            split,
            weights,
            settings.seed,
            settings.limits,
            scores=settings.scores,
            robot=settings.robot,
            file_sha256=hash_of_file(self.selection) if self.selection.name in registry.recorded() else "",
        )
        _require_equal(f"{trial.label}: its weights", weights.sha256 if weights else "", self.weights_sha256)
        _require_equal(f"{trial.label}: its settings", trial.identity(), self.identity)
        return trial


class JobOrder(Settings):
    """The description of one job."""

    settings: CompareSettings
    """The settings of the run, with the recording of this job alone."""
    name: str
    """The name of the split."""
    identity: RecordingIdentity
    """The recording and its stretches must have this identity on the machine."""
    row: RowOrder | None = None
    """None for the oracle."""
    record: TrialRecord | None = None
    """The record of a complete trial that is measured."""
    thresholds: Path
    """The folder with the thresholds chosen so far in the run."""
    versions: dict[str, str]
    """Versions on the host of everything that can change a score."""

    @classmethod
    def of(
        cls,
        subject: Trial | EvaluationSplit,
        shared: SharedInputs,
        record: TrialRecord | None = None,
    ) -> JobOrder:
        """The order of a job on a trial, or of the oracle on a split."""
        split = subject.split if isinstance(subject, Trial) else subject
        settings = shared.settings
        alone = {
            "recordings": (f"{split.path.absolute()}{split.whole.removeprefix(name_from(split.path))}",),
            "trackers": (),
            "validation": settings.validation and _with_absolute_path(settings.validation),
        }
        return cls(
            settings=settings.model_copy(update=alone),
            name=split.name,
            identity=identity_of(split),
            row=RowOrder.of(subject) if isinstance(subject, Trial) else None,
            record=record,
            thresholds=shared.folder,
            versions=versions(),
        )

    @classmethod
    def read(cls, text: str) -> JobOrder:
        """Parse an order. Raises EngineError."""
        try:
            return cls.model_validate_json(text)
        except ValidationError as error:
            raise EngineError(f"not a job of this version of gridtrack ({error.error_count()} errors)") from None

    def split(self) -> EvaluationSplit:
        """The recording on this machine. Raises a GridtrackError if it, or a library, is a different one here."""
        here = versions()
        for name, version in self.versions.items():
            _require_equal(name, here.get(name, "not installed"), version)
        settings = self.settings
        whole = plan_split(settings.recordings[0], settings.validation, sampling_of(settings))
        split = next((one for one in segmented(whole, settings) if one.name == self.name), whole)
        _require_equal(f"{split.path}", identity_of(split), self.identity)
        return split


def _require_equal(what: str, here: object, there: object) -> None:
    if here != there:
        raise EngineError(
            f"{what}: {_short(here)} on this machine ({platform.node()}), {_short(there)} where the run was started:"
            " every machine of an engine has the same recordings, weights and versions"
        )


def _short(value: object) -> str:
    return str(value) if isinstance(value, str) else "another one"


def _with_absolute_path(text: str) -> str:
    path, stretch = parse_stretch(text)
    return f"{path.absolute()}" if stretch is None else f"{path.absolute()}@{text.rpartition('@')[2]}"


def execute(folder: str) -> bool:
    """Execute the task in `folder`, in a process of a cluster. Returns whether nothing interrupted it."""
    return run_task(Path(folder), ordered_job, error_with_location)


def ordered_job(folder: TaskFolder, note: Callable[[str], None]) -> RunJob:
    """The job that a task's order describes. Raises a GridtrackError if this machine differs from the host."""
    order = JobOrder.read(folder.order())
    split = order.split()
    shared = SharedInputs(order.settings, note, order.thresholds)
    if order.row is None:
        return OracleJob(split, folder.files, shared)
    trial = order.row.trial(split, order.settings)
    if order.record is None:
        return TrialJob(trial, folder.files, shared)
    return RobustnessJob(trial, order.record, folder.files, shared)
