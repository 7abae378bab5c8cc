"""The stages of a run: scores, priors, degraded input, and what needs the machine for one tracker alone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from contextlib import contextmanager
from itertools import groupby
from pathlib import Path
from typing import Any

from gridtrack.evaluation.engines.engine import WAKE_S, Engine, RunObserver
from gridtrack.evaluation.results.trial_record import TrialRecord
from gridtrack.evaluation.runs.deadline_pass import measure_deadline
from gridtrack.evaluation.runs.latency_pass import measure_latency
from gridtrack.evaluation.runs.plan import ComparisonPlan, Trial
from gridtrack.evaluation.runs.prior_pass import trials_with_priors
from gridtrack.evaluation.runs.shared_inputs import SharedInputs
from gridtrack.evaluation.runs.trial import unstarted
from gridtrack.evaluation.runs.works import (
    OracleWork,
    PriorWork,
    RobustnessWork,
    RunWork,
    TrialWork,
    not_measured,
    written,
)


class Stages:
    """The stages of one run, in the order of its methods, and the records so far."""

    def __init__(self, plan: ComparisonPlan, folder: Path, progress: RunObserver, engine: Engine) -> None:
        self.notices: list[str] = []
        """Failed measurements of complete trials, with their reasons."""
        self._plan, self._folder, self._progress, self._engine = plan, folder, progress, engine
        self._shared = SharedInputs(plan.settings, progress.note, engine.scratch, max(1, engine.capacity))
        self._records: dict[str, TrialRecord] = {}

    def keep(self, name: str, record: TrialRecord) -> None:
        """Keep the record of a trial that does not run again."""
        self._records[name] = record
        self._progress.ended(name, record)

    def planned_frames(self) -> dict[str, int]:
        """The frames of every trial and oracle without a record, with a validation stretch where it is first used."""
        planned: dict[str, int] = {}
        chosen: set[str] = set()
        for work in self._without_score():
            choosing = () if work.thresholds_key in chosen else work.validation or ()
            planned[work.name] = len(work.split.test) + len(choosing)
            chosen.add(work.thresholds_key)
        return planned

    def planned_passes(self) -> list[str]:
        """What is requested beside the scores, in the order in which it is measured."""
        asked = self._plan.settings
        requested = (("degraded input", asked.degrade), ("latency", asked.latency), ("deadlines", asked.deadline))
        return [name for name, wanted in requested if wanted]

    def score_missing(self) -> None:
        """Run every trial without a record, and score the oracle on every recording with truth that lacks it."""
        self._carry_out(self._without_score())

    def _without_score(self) -> list[TrialWork | OracleWork]:
        """What has no record, recording after recording, so that the regions of each are found once."""
        works: list[TrialWork | OracleWork] = []
        for split, trials in groupby(self._plan.trials, lambda trial: trial.split):
            works += [TrialWork(trial, self._folder / trial.name, self._shared) for trial in trials]
            if split.test.has_truth:
                works.append(OracleWork(split, self._folder / split.oracle_name, self._shared))
        return [work for work in works if work.name not in self._records]

    def measure_priors(self) -> None:
        """Measure what each row with weights expects of each place, where it is missing."""
        trials = trials_with_priors(self._complete(), self._records)
        self._carry_out([PriorWork(t, self._records[t.name], self._folder / t.name, self._shared) for t in trials])

    def measure_robustness(self) -> None:
        """Run the robustness pass of every complete trial, where it is requested and missing."""
        degradation = self._plan.settings.degrade
        if degradation is None:
            return
        done = {name for name, r in self._records.items() if r.robustness and r.robustness.degradation == degradation}
        trials = [trial for trial in self._complete() if trial.name not in done]
        self._carry_out([RobustnessWork(t, self._records[t.name], self._folder / t.name, self._shared) for t in trials])

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
                    regions = self._shared.regions_of(trial.split)
                    self._add(trial, deadline=measure_deadline(trial, regions, record.thresholds, folder))

    def all_records(self) -> dict[str, TrialRecord]:
        """The record of every trial of the plan, also of those that an interrupt prevented, and of the oracles."""
        return {trial.name: unstarted(trial) for trial in self._plan.trials} | self._records

    def _complete(self) -> list[Trial]:
        return [trial for trial in self._plan.trials if self._records[trial.name].outcome == "ok"]

    def _carry_out(self, works: Sequence[RunWork]) -> None:
        """Let the engine carry out `works`; on an error or an interrupt, end all of them before it is raised."""
        waiting: dict[Future[TrialRecord], RunWork] = {}
        try:
            waiting.update(zip(self._engine.submit(works), works, strict=True))
            while waiting:
                for future in wait(waiting, WAKE_S, return_when=FIRST_COMPLETED).done:
                    self._take(waiting[future], future)
                    del waiting[future]
        except BaseException:
            self._engine.cancel()
            for future in wait(waiting).done:
                if not future.cancelled() and future.exception() is None:
                    self._take(waiting[future], future)
            raise

    def _take(self, work: RunWork, future: Future[TrialRecord]) -> None:
        """Keep the record of a work that has ended, or the notice of one that has none."""
        error = future.exception()
        if error is not None and not isinstance(error, Exception):
            raise error
        result = work.on_error(error) if error else future.result()
        if isinstance(result, str):
            self._notify(result)
            return
        if isinstance(work, TrialWork):
            result = work.taken(result)
        self._records[work.name] = result
        if isinstance(work, TrialWork | OracleWork):
            if result.outcome == "ok":
                self._shared.thresholds.learn(work.thresholds_key, result.thresholds)
            self._progress.ended(work.name, result)

    @contextmanager
    def _measuring(self, trial: Trial, what: str) -> Iterator[None]:
        """An error in the block leaves the trial without this measurement, with a notice."""
        self._progress.note(f"{trial.name}: {what}")
        try:
            yield
        except Exception as error:  # noqa: BLE001 the other trials continue, and the summary reports it
            self._notify(not_measured(trial, what, error))

    def _add(self, trial: Trial, **measured: Any) -> None:
        """Add measurements to the trial's record, and write it."""
        record = self._records[trial.name].model_copy(update=measured)
        self._records[trial.name] = written(self._folder / trial.name, record)

    def _notify(self, notice: str) -> None:
        self.notices.append(notice)
        self._progress.note(notice)
