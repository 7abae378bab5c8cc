"""The runner: the trials of a plan in parallel, each in its own process, unaffected by failures of the others."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Protocol

from gridtrack.evaluation.comparison.deadline_pass import measure_deadline
from gridtrack.evaluation.comparison.latency_pass import measure_latency
from gridtrack.evaluation.comparison.oracle import oracle_validation, run_oracle
from gridtrack.evaluation.comparison.plan import ComparisonPlan, Trial, with_copied_weights
from gridtrack.evaluation.comparison.prior_pass import PriorRun, trials_with_priors
from gridtrack.evaluation.comparison.provenance import usable_cores
from gridtrack.evaluation.comparison.robustness_pass import RobustnessRun
from gridtrack.evaluation.comparison.run_folder import RunFolder
from gridtrack.evaluation.comparison.run_lock import run_lock
from gridtrack.evaluation.comparison.shared_thresholds import SharedThresholds, oracle_key
from gridtrack.evaluation.comparison.trial import Interrupted, TrialRun, error_with_location, failed, unstarted
from gridtrack.evaluation.processes.outcome import TrialEnded
from gridtrack.evaluation.results.columns import PRIOR_TABLE
from gridtrack.evaluation.results.summary import RunSummary
from gridtrack.evaluation.results.trial_record import TrialRecord, hashes_of
from gridtrack.evaluation.scoring.splits import EvaluationSplit, SplitRegions

WAKE_S = 0.2
"""Period at which the main thread checks for an interrupt: a library may have made its wait ignore signals."""


class RunObserver(Protocol):
    """Receives the progress of a run, from several threads; a trial is named like its folder."""

    def note(self, text: str) -> None:
        """A message for the user, one line."""

    def planned(self, frames: Mapping[str, int]) -> None:
        """The trials that will run, and about how many frames each will receive."""

    def started(self, trial: str, frames: int) -> None:
        """A trial starts; it will receive `frames` frames."""

    def advanced(self, trial: str) -> None:
        """The next frame is delivered."""

    def ended(self, trial: str, record: TrialRecord) -> None:
        """A trial has ended, or its record is kept from an earlier run."""


def run(plan: ComparisonPlan, command: Sequence[str], progress: RunObserver) -> RunSummary:
    """Run `plan` and return the summary; `command` is the command line, stored with the results.

    An interrupt (Ctrl-C) ends the trackers, keeps the scores so far, and returns the summary with `interrupted` true.
    Raises RunError where the run's folder contains another run, or another run has locked it.
    """
    with run_lock(plan.settings.out), TemporaryDirectory(prefix="gridtrack-weights-") as folder:
        return _run(with_copied_weights(plan, Path(folder)), command, progress)


def _run(plan: ComparisonPlan, command: Sequence[str], progress: RunObserver) -> RunSummary:
    folder = RunFolder.prepare(plan, command)
    for notice in plan.notices:
        progress.note(notice)
    pool = TrialPool(plan, folder.path, progress)
    for name, record in folder.kept_records().items():
        pool.keep(name, record)
    progress.planned(pool.planned_frames())
    interrupted = False
    try:
        pool.run_missing()
        pool.measure_priors()
        pool.measure_robustness()
        pool.measure_alone()
    except KeyboardInterrupt:
        interrupted = True
    return folder.finish(pool.all_records(), pool.notices, interrupted)


class Interruptible(Protocol):
    """What runs in a thread and ends when it is told to."""

    def interrupt(self) -> None:
        """End it from another thread, also during a call."""


class TrialPool:
    """A pool of threads that run the trials of a plan, and the records so far."""

    def __init__(self, plan: ComparisonPlan, folder: Path, progress: RunObserver) -> None:
        self.notices: list[str] = []
        """Failed measurements of complete trials, with their reasons."""
        self._plan, self._folder, self._progress = plan, folder, progress
        self._stop = threading.Event()
        self._running: set[Interruptible] = set()
        self._records: dict[str, TrialRecord] = {}
        self._regions: dict[str, SplitRegions] = {}
        self._thresholds = SharedThresholds()

    def keep(self, name: str, record: TrialRecord) -> None:
        """Keep the record of a trial that does not run again."""
        self._records[name] = record
        self._progress.ended(name, record)

    def planned_frames(self) -> dict[str, int]:
        """The frames of every trial and oracle without a record; thresholds that trials share are counted each time."""
        planned = {trial.name: len(trial.test) + len(trial.validation or ()) for trial in self._plan.trials}
        for split in self._plan.splits:
            if split.test.has_truth:
                planned[split.oracle_name] = len(split.test) + len(oracle_validation(split) or ())
        return {name: frames for name, frames in planned.items() if name not in self._records}

    def run_missing(self) -> None:
        """Run every trial without a record, and score the oracle on every recording with truth that lacks it."""
        trials = [trial for trial in self._plan.trials if trial.name not in self._records]
        unknown = [split for split in self._plan.splits if split.oracle_name not in self._records]
        oracles = [split for split in unknown if split.test.has_truth]
        tasks = [partial(self._run_trial, trial) for trial in trials] + [partial(self._run_oracle, s) for s in oracles]
        self._in_parallel(tasks, [*(trial.split for trial in trials), *oracles])

    def measure_priors(self) -> None:
        """Measure what each row with weights expects of each place, where it is missing."""
        trials = trials_with_priors(self._complete(), self._records)
        self._in_parallel([partial(self._measure_prior, trial) for trial in trials], [])

    def measure_robustness(self) -> None:
        """Run the robustness pass of every complete trial, where it is requested and missing."""
        degradation = self._plan.settings.degrade
        if degradation is None:
            return
        done = {name for name, r in self._records.items() if r.robustness and r.robustness.degradation == degradation}
        trials = [trial for trial in self._complete() if trial.name not in done]
        self._in_parallel(
            [partial(self._measure_robustness, trial) for trial in trials], [trial.split for trial in trials]
        )

    def measure_alone(self) -> None:
        """Run the passes that need the machine for one tracker alone, where they are requested and missing."""
        settings = self._plan.settings
        for trial in self._complete():
            record, folder = self._records[trial.name], self._folder / trial.name
            if settings.latency and record.latency_ms is None:
                with self._measuring(trial, "latency, alone on the machine"):
                    self._add(trial, latency_ms=measure_latency(trial, folder))
            if settings.deadline and record.deadline is None:
                with self._measuring(trial, "deadlines, alone on the machine"):
                    regions = self._regions_of(trial.split)
                    self._add(trial, deadline=measure_deadline(trial, regions, record.thresholds, folder))

    def all_records(self) -> dict[str, TrialRecord]:
        """The record of every trial of the plan, also of those that an interrupt prevented, and of the oracles."""
        return {trial.name: unstarted(trial) for trial in self._plan.trials} | self._records

    def _complete(self) -> list[Trial]:
        return [trial for trial in self._plan.trials if self._records[trial.name].outcome == "ok"]

    def _regions_of(self, split: EvaluationSplit) -> SplitRegions:
        """Region maps of a split, computed once in a run."""
        if split.name not in self._regions:
            self._progress.note(f"{split.name}: finding its static cells")
            self._regions[split.name] = split.regions()
        return self._regions[split.name]

    def _in_parallel(self, tasks: Sequence[Callable[[], None]], splits: Sequence[EvaluationSplit]) -> None:
        """Run tasks on `splits` in parallel; on an error or an interrupt, end all of them before it is raised."""
        for split in splits:
            self._regions_of(split)
        settings = self._plan.settings
        jobs = settings.jobs or max(1, usable_cores() // settings.limits.threads)
        with ThreadPoolExecutor(jobs, "trial") as pool:
            futures = [pool.submit(task) for task in tasks]
            try:
                pending = set(futures)
                while pending:
                    done, pending = wait(pending, WAKE_S, return_when=FIRST_COMPLETED)
                    for future in done:
                        future.result()
            except BaseException:
                self._end_all(futures)
                raise

    def _run_trial(self, trial: Trial) -> None:
        """Run one trial; an error outside its tracker gives the outcome `failed` and stops no other trial."""
        try:
            regions = self._regions_of(trial.split)
            on_frame = partial(self._next_frame, trial.name)
            run = TrialRun(trial, regions, self._folder / trial.name, on_frame, self._thresholds)
            self._progress.started(trial.name, run.frames)
            with self._interruptible(run):
                record = run.run()
        except Exception as error:  # noqa: BLE001 the other trials continue, and the summary reports it
            record = failed(trial, error)
        self._records[trial.name] = record
        self._progress.ended(trial.name, record)

    def _run_oracle(self, split: EvaluationSplit) -> None:
        """Score the oracle on one recording; where that fails, the run continues without it."""
        name = split.oracle_name
        validation = () if self._thresholds.known(oracle_key(split)) else oracle_validation(split) or ()
        self._progress.started(name, len(split.test) + len(validation))
        try:
            regions, on_frame = self._regions_of(split), partial(self._next_frame, name)
            record = run_oracle(split, regions, self._folder / name, on_frame, self._thresholds)
        except Interrupted:
            return
        except Exception as error:  # noqa: BLE001 as for a trial
            self.notices.append(f"{split.name}: no oracle: {error_with_location(error)}")
            self._progress.note(self.notices[-1])
            return
        self._records[name] = record
        self._progress.ended(name, record)

    def _measure_robustness(self, trial: Trial) -> None:
        degradation, folder = self._plan.settings.degrade, self._folder / trial.name
        assert degradation is not None
        record = self._records[trial.name]
        with self._measuring(trial, "degraded input"):
            run = RobustnessRun(trial, degradation, folder)
            with self._interruptible(run):
                robustness = run.run(self._regions_of(trial.split), record.thresholds, self._raise_if_stopped)
            self._add(trial, robustness=robustness)

    def _measure_prior(self, trial: Trial) -> None:
        folder = self._folder / trial.name
        with self._measuring(trial, "its prior"):
            run = PriorRun(trial, folder)
            with self._interruptible(run):
                run.run(self._raise_if_stopped)
            self._add(trial, files={**self._records[trial.name].files, **hashes_of(folder, (PRIOR_TABLE.file,))})

    @contextmanager
    def _interruptible(self, run: Interruptible) -> Iterator[None]:
        self._running.add(run)
        try:
            yield
        finally:
            self._running.discard(run)

    @contextmanager
    def _measuring(self, trial: Trial, what: str) -> Iterator[None]:
        """An error in the block leaves the trial without this measurement, with a notice."""
        self._progress.note(f"{trial.name}: {what}")
        reason = ""
        try:
            yield
        except Interrupted:
            return
        except TrialEnded as ended:
            reason = str(ended)
        except Exception as error:  # noqa: BLE001 as for a trial
            reason = error_with_location(error)
        if reason and not self._stop.is_set():
            self.notices.append(f"{trial.name}: no measurement of {what}: {reason}")
            self._progress.note(self.notices[-1])

    def _add(self, trial: Trial, **measured: Any) -> None:
        """Add measurements to the trial's record, and write it."""
        self._records[trial.name] = self._records[trial.name].model_copy(update=measured)
        self._records[trial.name].write(self._folder / trial.name)

    def _next_frame(self, name: str) -> None:
        self._raise_if_stopped()
        self._progress.advanced(name)

    def _raise_if_stopped(self) -> None:
        if self._stop.is_set():
            raise Interrupted

    def _end_all(self, futures: Sequence[Future[None]]) -> None:
        """End the trackers now: waiting trials never start, running calls are interrupted."""
        self._stop.set()
        for future in futures:
            future.cancel()
        for run in tuple(self._running):
            run.interrupt()
