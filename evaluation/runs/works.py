"""The works of a run: the scores of a trial, those of the oracle, and the measurements that follow the scores."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Protocol

from gridtrack.common.errors import GridtrackError
from gridtrack.evaluation.engines.engine import Monitor
from gridtrack.evaluation.hosting.outcome import TrialEnded
from gridtrack.evaluation.results.columns import PRIOR_TABLE
from gridtrack.evaluation.results.trial_record import TrialRecord, hashes_of
from gridtrack.evaluation.runs.oracle import ORACLE_REPLACES, oracle_validation, run_oracle
from gridtrack.evaluation.runs.orders import Order, OrderKind
from gridtrack.evaluation.runs.plan import Trial
from gridtrack.evaluation.runs.prior_pass import PriorRun
from gridtrack.evaluation.runs.robustness_pass import RobustnessRun
from gridtrack.evaluation.runs.shared_inputs import SharedInputs
from gridtrack.evaluation.runs.shared_thresholds import oracle_key, trial_key
from gridtrack.evaluation.runs.trial import REPLACED, TrialRun, error_with_location, failed
from gridtrack.evaluation.scoring.splits import EvaluationSplit


class _Interruptible(Protocol):
    def interrupt(self) -> None: ...


class _InterruptedOnce:
    """Passes an interrupt from another thread on to what runs, also where that has not begun yet."""

    def __init__(self) -> None:
        self._runs: _Interruptible | None = None
        self._interrupted = False

    def interrupt(self) -> None:
        """End what runs, or what begins next."""
        self._interrupted = True
        if self._runs is not None:
            self._runs.interrupt()

    def begin(self, run: _Interruptible) -> None:
        """From now on `run` is interrupted."""
        self._runs = run
        if self._interrupted:
            run.interrupt()


class TrialWork(_InterruptedOnce):
    """The scores of a trial. An error outside its tracker gives the outcome `failed`."""

    def __init__(self, trial: Trial, folder: Path, shared: SharedInputs) -> None:
        """The files of the trial go to `folder`."""
        super().__init__()
        self.trial, self._folder, self._shared = trial, folder, shared
        self.name, self.replaces = trial.name, REPLACED
        self.split, self.validation = trial.split, trial.split.validation

    @property
    def thresholds_key(self) -> str:
        """Identifies its thresholds among those of the run."""
        return trial_key(self.trial)

    def order(self) -> str:
        """Its description as JSON."""
        return Order.of("scores", self.trial, self._shared).model_dump_json(by_alias=True)

    def run(self, monitor: Monitor) -> TrialRecord:
        """Run the trial to its end, successful or not."""
        regions = self._shared.regions_of(self.trial.split, monitor.check)
        run = TrialRun(self.trial, regions, self._folder, monitor.next_frame, self._shared.thresholds)
        monitor.started(run.frames)
        self.begin(run)
        return run.run()

    def on_error(self, error: Exception) -> TrialRecord:
        """The record of a trial that could not write one."""
        return self._written(failed(self.trial, _reason(error)))

    def taken(self, record: TrialRecord) -> TrialRecord:
        """The `record` of the trial; how to train is told as of the whole run: another machine knows this trial alone.

        The record is written again where that differs.
        """
        if record.outcome != "untrained" or record.reason == self.trial.how_to_train:
            return record
        return self._written(record.model_copy(update={"reason": self.trial.how_to_train}))

    def _written(self, record: TrialRecord) -> TrialRecord:
        """`record`, written to the trial's folder where that can be done."""
        with suppress(OSError):
            self._folder.mkdir(parents=True, exist_ok=True)
            record.write(self._folder)
        return record


class OracleWork:
    """The scores of the oracle on one recording; where that fails, the run continues without it."""

    def __init__(self, split: EvaluationSplit, folder: Path, shared: SharedInputs) -> None:
        """The files of the oracle go to `folder`."""
        self.split, self._folder, self._shared = split, folder, shared
        self.name, self.replaces = split.oracle_name, ORACLE_REPLACES
        self.validation = oracle_validation(split)

    @property
    def thresholds_key(self) -> str:
        """Identifies its thresholds among those of the run."""
        return oracle_key(self.split)

    def order(self) -> str:
        """Its description as JSON."""
        return Order.of("oracle", self.split, self._shared).model_dump_json(by_alias=True)

    def run(self, monitor: Monitor) -> TrialRecord:
        """Score the oracle. Raises Interrupted."""
        split, thresholds = self.split, self._shared.thresholds
        validation = () if thresholds.known(self.thresholds_key) else self.validation or ()
        monitor.started(len(split.test) + len(validation))
        return run_oracle(
            split, self._shared.regions_of(split, monitor.check), self._folder, monitor.next_frame, thresholds
        )

    def interrupt(self) -> None:
        """It waits for no other process, so the next frame ends it."""

    def on_error(self, error: Exception) -> str:
        """The notice for the user."""
        return f"{self.split.name}: no oracle: {_reason(error)}"


class _MeasurementWork(_InterruptedOnce):
    """A measurement that follows the scores of a trial, added to the trial's record."""

    kind: OrderKind
    what: str
    """Its name in notices."""

    def __init__(self, trial: Trial, record: TrialRecord, folder: Path, shared: SharedInputs) -> None:
        """Its files go to the trial's `folder`."""
        super().__init__()
        self.trial, self.record, self._folder, self._shared = trial, record, folder, shared
        self.name, self.replaces = trial.name, ()

    def order(self) -> str:
        """Its description as JSON."""
        return Order.of(self.kind, self.trial, self._shared, self.record).model_dump_json(by_alias=True)

    def on_error(self, error: Exception) -> str:
        """The notice for the user."""
        return not_measured(self.trial, self.what, error)


class PriorWork(_MeasurementWork):
    """What a row with weights expects of a place."""

    kind: OrderKind = "prior"
    what = "its prior"

    def run(self, monitor: Monitor) -> TrialRecord:
        """Measure the prior. Raises Interrupted, TrialEnded."""
        monitor.note(f"{self.name}: {self.what}")
        run = PriorRun(self.trial, self._folder)
        self.begin(run)
        run.run(monitor.check)
        files = {**self.record.files, **hashes_of(self._folder, (PRIOR_TABLE.file,))}
        return written(self._folder, self.record.model_copy(update={"files": files}))


class RobustnessWork(_MeasurementWork):
    """The scores of a trial on the degraded input that the settings of the run ask for."""

    kind: OrderKind = "robustness"
    what = "degraded input"

    def run(self, monitor: Monitor) -> TrialRecord:
        """Run the pass. Raises Interrupted, TrialEnded."""
        monitor.note(f"{self.name}: {self.what}")
        degradation = self._shared.settings.degrade
        assert degradation is not None, "the run asks for no degraded input"
        run = RobustnessRun(self.trial, degradation, self._folder)
        self.begin(run)
        robustness = run.run(
            self._shared.regions_of(self.trial.split, monitor.check), self.record.thresholds, monitor.check
        )
        return written(self._folder, self.record.model_copy(update={"robustness": robustness}))


RunWork = TrialWork | OracleWork | PriorWork | RobustnessWork


def written(folder: Path, record: TrialRecord) -> TrialRecord:
    """`record`, written into the trial's folder. Raises OSError."""
    record.write(folder)
    return record


def not_measured(trial: Trial, what: str, error: Exception) -> str:
    """The notice about a complete trial that lacks a measurement."""
    return f"{trial.name}: no measurement of {what}: {_reason(error)}"


def _reason(error: Exception) -> str:
    return str(error) if isinstance(error, TrialEnded | GridtrackError) else error_with_location(error)
