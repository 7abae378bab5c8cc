"""The runner: an engine executes the jobs of a plan, stage by stage, from the run's folder to its summary."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import contextmanager, suppress
from itertools import groupby, zip_longest
from pathlib import Path
from typing import Any, Protocol

from gridtrack.common.notices import Notice, by_kind
from gridtrack.evaluation.engines.engine import WAKE_S, Engine, JobObserver, LocalEngine
from gridtrack.evaluation.engines.ray_cluster import RayCluster
from gridtrack.evaluation.engines.remote import RemoteEngine
from gridtrack.evaluation.engines.slurm_cluster import SlurmCluster, SlurmSettings
from gridtrack.evaluation.runs.conditions import measure_deadline, measure_latency
from gridtrack.evaluation.runs.jobs import (
    OracleJob,
    RobustnessJob,
    RunJob,
    SharedInputs,
    TrialJob,
    execute,
    not_measured,
)
from gridtrack.evaluation.runs.plan import ComparisonPlan, Trial, with_copied_weights
from gridtrack.evaluation.runs.run_folder import RunFolder, refuse_other_files, run_lock, usable_cores, without_edited
from gridtrack.evaluation.runs.settings import CompareSettings
from gridtrack.evaluation.runs.summary import RunSummary
from gridtrack.evaluation.runs.trial import unstarted
from gridtrack.evaluation.runs.trial_record import OUTCOME_FILE, TrialRecord


class RunObserver(JobObserver, Protocol):
    """Receives the progress of a run, from several threads. A trial has the name of its folder."""

    def planned(self, frames: Mapping[str, int], then: Sequence[str] = ()) -> None:
        """The trials that will run, with the expected frames of each; `then`: the measurements that follow."""

    def ended(self, trial: str, record: TrialRecord) -> None:
        """A trial has ended, or its record is kept from an earlier run."""


def run(plan: ComparisonPlan, command: Sequence[str], progress: RunObserver) -> RunSummary:
    """Run `plan` and return the summary; `command` is the command line, stored with the results.

    An interrupt (Ctrl-C), or a lack of memory, ends the trackers, keeps the scores so far, and returns the summary with
    `interrupted` true; during the summary it is re-raised, after a note.
    Raises RunError if the run's folder has another run or other files, or another run has locked it.
    """
    with run_lock(plan.settings.out):
        refuse_other_files(plan.settings.out)
        with engine_of(plan.settings, progress) as engine:
            return _run(with_copied_weights(plan, engine.scratch), command, progress, engine)


def _run(plan: ComparisonPlan, command: Sequence[str], progress: RunObserver, engine: Engine) -> RunSummary:
    folder = RunFolder.prepare(plan, command)
    for kind in by_kind(plan.notices, [split.name for split in plan.splits]):
        progress.note(kind.text)
    stages = Stages(plan, folder.path, progress, engine)
    stages.keep(without_edited(plan, folder.kept_records(), progress.note))
    planned = stages.planned_frames()
    _remove_records(folder.path, planned)
    progress.planned(planned, stages.planned_measurements())
    interrupted = False
    try:
        stages.score_missing()
        stages.measure_robustness()
        stages.measure_alone()
    except KeyboardInterrupt:
        interrupted = True
    except MemoryError:
        interrupted = True
        progress.note("too little memory: the scores so far are kept; continue with --resume and fewer --jobs")
    try:
        summary = folder.finish(stages.all_records(), stages.notices, interrupted)
    except (KeyboardInterrupt, MemoryError) as end:
        why = "too little memory" if isinstance(end, MemoryError) else "interrupted"
        progress.note(f"{why} while the summary was made: the scores are kept; continue with --resume")
        raise
    found = [notice for notice in summary.notices if notice not in (*plan.notices, *stages.notices)]
    for kind in by_kind(found, summary.recordings):
        progress.note(kind.text)
    return summary


def _remove_records(folder: Path, names: Iterable[str]) -> None:
    """Remove earlier records of the trials and oracles `names`: a trial that cannot start replaces nothing.

    Raises OSError.
    """
    for name in names:
        with suppress(FileNotFoundError, NotADirectoryError):
            (folder / name / OUTCOME_FILE).unlink()


def engine_of(settings: CompareSettings, progress: JobObserver) -> Engine:
    """The engine of a run; its folder exists. Raises a GridtrackError if there is no such cluster."""
    cores = settings.limits.threads
    if settings.engine == "ray":
        return RemoteEngine(RayCluster(settings.address, cores, execute), settings.out, progress)
    if settings.engine == "slurm":
        cluster = SlurmCluster(settings.slurm or SlurmSettings(), cores, execute)
        return RemoteEngine(cluster, settings.out, progress)
    return LocalEngine(settings.jobs or max(1, usable_cores() // cores), settings.out, progress)


def one_of_each_recording(jobs: Sequence[RunJob]) -> Iterator[Sequence[RunJob]]:
    """The jobs in rounds with one job of each recording.

    Trackers that run at the same time can talk even in a sandbox, by the processor time: one that is ahead on a
    recording could tell its future.
    """
    by_recording: dict[Path, list[RunJob]] = {}
    for job in jobs:
        by_recording.setdefault(job.split.path, []).append(job)
    for at_once in zip_longest(*by_recording.values()):
        yield [job for job in at_once if job is not None]


class Stages:
    """The stages of one run, in the order of its methods, and the records so far."""

    def __init__(self, plan: ComparisonPlan, folder: Path, progress: RunObserver, engine: Engine) -> None:
        self.notices: list[Notice] = []
        """Failed measurements of complete trials, with their reasons."""
        self._plan, self._folder, self._progress, self._engine = plan, folder, progress, engine
        self._shared = SharedInputs(plan.settings, progress.note, engine.scratch, max(1, engine.capacity))
        self._records: dict[str, TrialRecord] = {}

    def keep(self, records: Mapping[str, TrialRecord]) -> None:
        """Keep the records, by trial, of trials that do not run again; others share the thresholds that they chose."""
        for name, record in records.items():
            self._records[name] = record
            self._progress.ended(name, record)
        for job in self._scoring():
            if kept := records.get(job.name):
                self._share_thresholds(job, kept)

    def planned_frames(self) -> dict[str, int]:
        """The frames of every trial and oracle without a record, with a validation stretch where it is first used."""
        planned: dict[str, int] = {}
        chosen: set[str] = set()
        for job in self._unscored():
            known = job.thresholds_key in chosen or self._shared.thresholds.known(job.thresholds_key)
            validation = () if known else job.validation or ()
            planned[job.name] = len(job.split.test) + len(validation)
            chosen.add(job.thresholds_key)
        return planned

    def planned_measurements(self) -> list[str]:
        """The measurements requested beside the scores, in their order."""
        settings = self._plan.settings
        requested = {"degraded input": settings.degrade, "latency": settings.latency, "deadlines": settings.deadline}
        return [name for name, wanted in requested.items() if wanted]

    def score_missing(self) -> None:
        """Run every trial without a record, and score the oracle on every recording with truth that lacks it."""
        self._execute(self._unscored())

    def _unscored(self) -> list[TrialJob | OracleJob]:
        return [job for job in self._scoring() if job.name not in self._records]

    def _scoring(self) -> list[TrialJob | OracleJob]:
        """The jobs that score, recording after recording, so that the regions of each are found once."""
        jobs: list[TrialJob | OracleJob] = []
        for split, trials in groupby(self._plan.trials, lambda trial: trial.split):
            jobs += [TrialJob(trial, self._folder / trial.name, self._shared) for trial in trials]
            if split.test.has_truth:
                jobs.append(OracleJob(split, self._folder / split.oracle_name, self._shared))
        return jobs

    def measure_robustness(self) -> None:
        """Run the robustness pass of every complete trial, if it is requested and missing."""
        degradation = self._plan.settings.degrade
        if degradation is None:
            return
        done = {name for name, r in self._records.items() if r.robustness and r.robustness.degradation == degradation}
        trials = [trial for trial in self._live() if trial.name not in done]
        self._execute([RobustnessJob(t, self._records[t.name], self._folder / t.name, self._shared) for t in trials])

    def measure_alone(self) -> None:
        """Run the passes that need the machine for one tracker alone, if they are requested and missing."""
        settings = self._plan.settings
        for trial in self._live():
            record, folder = self._records[trial.name], self._folder / trial.name
            if settings.latency and record.latency_ms is None:
                with self._measuring(trial, "latency, alone on the machine"):
                    self._add(trial, latency_ms=measure_latency(trial, folder))
            if settings.deadline and record.deadline is None:
                with self._measuring(trial, "deadlines, alone on the machine"):
                    moments = self._shared.moments_of(trial.split, trial.selection.points)
                    self._add(trial, deadline=measure_deadline(trial, moments.test, record, folder))

    def all_records(self) -> dict[str, TrialRecord]:
        """The record of every trial of the plan, also of those that an interrupt prevented, and of the oracles."""
        return {trial.name: unstarted(trial) for trial in self._plan.trials} | self._records

    def _complete(self) -> list[Trial]:
        return [trial for trial in self._plan.trials if self._records[trial.name].outcome == "ok"]

    def _live(self) -> list[Trial]:
        """The complete trials of trackers that run; the input and the time of recorded forecasts cannot change."""
        return [trial for trial in self._complete() if self._records[trial.name].role != "recorded"]

    def _execute(self, jobs: Sequence[RunJob]) -> None:
        """Execute `jobs`: all at once as far as the engine can, in a sandbox one of each recording at a time."""
        settings = self._plan.settings
        apart = settings.limits.sandbox and settings.jobs is None
        for together in one_of_each_recording(jobs) if apart else [jobs]:
            self._execute_together(together)

    def _execute_together(self, jobs: Sequence[RunJob]) -> None:
        """Let the engine execute `jobs`; on an error or an interrupt, end all of them before it is re-raised."""
        waiting: dict[Future[TrialRecord], RunJob] = {}
        try:
            waiting.update(zip(self._engine.submit(jobs), jobs, strict=True))
            while waiting:
                for future in wait(waiting, WAKE_S, return_when=FIRST_COMPLETED).done:
                    self._collect(waiting[future], future)
                    del waiting[future]
        except BaseException:
            self._engine.cancel()
            for future in wait(waiting).done:
                if not future.cancelled() and future.exception() is None:
                    self._collect(waiting[future], future)
            raise

    def _collect(self, job: RunJob, future: Future[TrialRecord]) -> None:
        """Keep the record of a job that has ended, or the notice of one that has none."""
        error = future.exception()
        if error is not None and not isinstance(error, Exception):
            raise error
        result = job.on_error(error) if error else future.result()
        if isinstance(result, Notice):
            self._notify(result)
            return
        if isinstance(job, TrialJob):
            result = job.accepted(result)
        self._records[job.name] = result
        if isinstance(job, TrialJob | OracleJob):
            self._share_thresholds(job, result)
            self._progress.ended(job.name, result)

    def _share_thresholds(self, job: TrialJob | OracleJob, record: TrialRecord) -> None:
        if record.outcome == "ok":
            self._shared.thresholds.learn(job.thresholds_key, record.thresholds)

    @contextmanager
    def _measuring(self, trial: Trial, measurement: str) -> Iterator[None]:
        """An error in the block leaves the trial without this measurement, with a notice."""
        self._progress.note(f"{trial.name}: {measurement}")
        try:
            yield
        except Exception as error:  # noqa: BLE001 the other trials continue, and the summary reports it
            self._notify(not_measured(trial, measurement, error))

    def _add(self, trial: Trial, **measured: Any) -> None:
        """Add measurements to the trial's record, and write it."""
        record = self._records[trial.name].model_copy(update=measured)
        record.write(self._folder / trial.name)
        self._records[trial.name] = record

    def _notify(self, notice: Notice) -> None:
        self.notices.append(notice)
        self._progress.note(str(notice))
