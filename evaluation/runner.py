"""The runner: the trials of a plan side by side, each in its own process, whatever becomes of the others."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any, Protocol

from gridtrack.evaluation.courses import Regions
from gridtrack.evaluation.latency_pass import measure_latency
from gridtrack.evaluation.outcome import TrialEnded
from gridtrack.evaluation.plan import Plan, Trial
from gridtrack.evaluation.provenance import usable_cores
from gridtrack.evaluation.record import TrialRecord
from gridtrack.evaluation.run_folder import RunFolder
from gridtrack.evaluation.trial import Interrupted, TrialRun, unstarted


class Progress(Protocol):
    """Whoever shows how far a run is. Called from several threads; a trial is named as its folder is."""

    def note(self, text: str) -> None:
        """Something to know, in one line."""

    def started(self, trial: str, frames: int) -> None:
        """A trial begins, and is to be delivered `frames` frames."""

    def advanced(self, trial: str) -> None:
        """One more frame is being delivered."""

    def ended(self, trial: str, record: TrialRecord) -> None:
        """A trial has ended, or is kept from an earlier run."""


def run(plan: Plan, command: Sequence[str], progress: Progress) -> dict[str, Any]:
    """Run what `plan` names and return the summary; `command` is the command line to keep with the results.

    An interrupt (Ctrl-C) ends the trackers, keeps what was scored, and returns the summary with `interrupted` true.
    Raises RunError where the run's folder holds another run.
    """
    folder = RunFolder.prepare(plan, command)
    for notice in plan.notices:
        progress.note(notice)
    crew = _Crew(plan, folder.path, progress)
    for name, record in folder.kept_records().items():
        crew.keep(name, record)
    interrupted = False
    try:
        crew.run_trials()
        if plan.settings.latency:
            crew.measure_latencies()
    except KeyboardInterrupt:
        interrupted = True
    return folder.finish(crew.all_records(), interrupted)


class _Crew:
    """The threads that each see one trial through, and what they have brought back."""

    def __init__(self, plan: Plan, folder: Path, progress: Progress) -> None:
        self._plan, self._folder, self._progress = plan, folder, progress
        self._stop = threading.Event()
        self._running: set[TrialRun] = set()
        self._records: dict[str, TrialRecord] = {}

    def keep(self, name: str, record: TrialRecord) -> None:
        """Take over the record of a trial that need not run again."""
        self._records[name] = record
        self._progress.ended(name, record)

    def run_trials(self) -> None:
        """Run every trial that has no record yet; on an error or an interrupt, end all of them before it is raised."""
        todo = [trial for trial in self._plan.trials if trial.name not in self._records]
        regions = self._regions(todo)
        settings = self._plan.settings
        jobs = settings.jobs or max(1, usable_cores() // settings.limits.threads)
        with ThreadPoolExecutor(jobs, "trial") as pool:
            futures = [pool.submit(self._run_trial, trial, regions[trial.course.name]) for trial in todo]
            try:
                for future in as_completed(futures):
                    future.result()
            except BaseException:
                self._end_all(futures)
                raise

    def measure_latencies(self) -> None:
        """Time every complete trial's tracker, one at a time."""
        for trial in self._plan.trials:
            record = self._records[trial.name]
            if record.outcome != "ok" or record.latency_ms is not None:
                continue
            self._progress.note(f"{trial.name}: latency, alone on the machine")
            try:
                latency = measure_latency(trial, self._folder / trial.name)
            except TrialEnded as ended:
                self._progress.note(f"{trial.name}: no latency figures: {ended}")
                continue
            self._records[trial.name] = record.model_copy(update={"latency_ms": latency})
            self._records[trial.name].write(self._folder / trial.name)

    def all_records(self) -> dict[str, TrialRecord]:
        """The record of every trial of the plan; those that an interrupt kept from starting say so."""
        return {trial.name: self._records.get(trial.name) or unstarted(trial) for trial in self._plan.trials}

    def _regions(self, trials: Sequence[Trial]) -> dict[str, Regions]:
        """Regions of every course that is run, by its name."""
        regions: dict[str, Regions] = {}
        for course in {trial.course.name: trial.course for trial in trials}.values():
            self._progress.note(f"{course.name}: finding its static cells")
            regions[course.name] = course.regions()
        return regions

    def _run_trial(self, trial: Trial, regions: Regions) -> None:
        run = TrialRun(trial, regions, self._folder / trial.name, lambda: self._next_frame(trial))
        self._progress.started(trial.name, run.frames)
        self._running.add(run)
        try:
            record = run.run()
        finally:
            self._running.discard(run)
        self._records[trial.name] = record
        self._progress.ended(trial.name, record)

    def _next_frame(self, trial: Trial) -> None:
        if self._stop.is_set():
            raise Interrupted
        self._progress.advanced(trial.name)

    def _end_all(self, futures: Sequence[Future[None]]) -> None:
        """End the trackers now: those still waiting never start, those busy with a call end in it."""
        self._stop.set()
        for future in futures:
            future.cancel()
        for run in tuple(self._running):
            run.interrupt()
