"""A run's folder while it is filled: its lock, its record, the trials that a resumed run keeps, and its summary."""

from __future__ import annotations

import errno
import json
import os
import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache
from importlib import metadata
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TextIO

import psutil

from gridtrack.common.files import refuse_links
from gridtrack.common.notices import Notice
from gridtrack.evaluation.engines.engine import remove_scratch
from gridtrack.evaluation.hosting.outcome import TrialEnded
from gridtrack.evaluation.referee.splits import ORACLE
from gridtrack.evaluation.runs.finished import FinishedTrial
from gridtrack.evaluation.runs.plan import ComparisonPlan, Trial
from gridtrack.evaluation.runs.result_files import RunError
from gridtrack.evaluation.runs.run_record import (
    RUN_FILE,
    Machine,
    RunConfiguration,
    RunRecord,
    RunSettings,
    description_of,
    read_run_record,
)
from gridtrack.evaluation.runs.summarise import summarise
from gridtrack.evaluation.runs.summary import RunSummary, read_summary
from gridtrack.evaluation.runs.sums import SUMS_FILE
from gridtrack.evaluation.runs.trial_record import TrialRecord, code_differs, read_trial_record
from gridtrack.evaluation.scores.registry import scores

LOCK = ".lock"
UNSUPPORTED = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)
"""Errors of file systems without locks, such as some network file systems: the run continues without a lock."""
OTHER_VERSIONS = "trials kept from runs with other versions"
"""In the notice of a resumed run about trials of other versions, which every later run repeats."""
DISTRIBUTIONS = (
    "gridtrack", "numpy", "numba", "pydantic", "polars", "pyarrow", "mcap", "safetensors",
    "torch", "filterpy", "scipy", "scikit-learn", "gtsam",
)  # fmt: skip
"""Distributions with versions that can change a score."""


@contextmanager
def run_lock(folder: Path) -> Iterator[None]:
    """Create `folder` if it does not exist, and lock it against other runs.

    The lock file is never removed. The system releases the lock when this process ends; child processes do not inherit
    it. Raises RunError if another run has the lock, or the folder cannot be created.
    """
    if folder.is_file():
        raise RunError(f"{folder}: is a file; a run needs a folder: name one with --out")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RunError(f"{folder}: cannot be created ({error.strerror}): name another folder with --out") from None
    with _lock_file(folder / LOCK) as file:
        _lock(file, folder)
        remove_scratch(folder)  # of a killed run: an engine makes links in it
        refuse_links(folder, RunError)
        file.truncate(0)
        file.write(f"{os.getpid()}\n")
        file.flush()
        yield


def _lock_file(path: Path) -> TextIO:
    """The file of the lock, open. Raises RunError for a link and for another name of some file."""
    try:
        file = os.fdopen(os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666), "r+")
    except OSError as error:
        raise RunError(f"{path}: cannot be opened ({error.strerror}): remove it, or name another folder") from None
    if os.fstat(file.fileno()).st_nlink > 1:
        file.close()
        raise RunError(f"{path}: a file with a second name, which is not written to: remove it")
    return file


def _lock(file: TextIO, folder: Path) -> None:
    import fcntl  # POSIX only, like the limits of a tracker process; modules that only read runs do not need it

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        file.seek(0)
        raise RunError(
            f"{folder}: in use by another run (process {file.read(20).strip() or 'unknown'}): wait until it has ended,"
            " stop it, or name another folder with --out"
        ) from None
    except OSError as error:
        if error.errno not in UNSUPPORTED:
            raise


@dataclass(frozen=True, slots=True)
class RunFolder:
    """The folder of one run while it is filled."""

    path: Path
    plan: ComparisonPlan
    record: RunRecord
    earlier: RunRecord | None = None
    """The record of the run that is continued."""
    kept: dict[str, TrialRecord] = field(default_factory=dict)
    """The records found by `kept_records`."""

    @classmethod
    def prepare(cls, plan: ComparisonPlan, command: Sequence[str]) -> RunFolder:
        """Start a run in the folder, or with `resume` continue an earlier one.

        A continued run may have more trackers and recordings; nothing else may differ. The folder exists and is locked
        (`run_lock`). Raises RunError if it holds a different run.
        """
        path = plan.settings.out
        record = _new_record(plan, command)
        earlier = _earlier_record(path)
        if earlier is not None and not plan.settings.resume:
            raise holds_a_run(path)
        changed = _difference(earlier.configuration, record.configuration) if earlier else ""
        if changed:
            raise RunError(
                f"{path} holds a run of another configuration ({changed}): name another folder with --out, or repeat"
                f" its command (`command` in {RUN_FILE})"
            )
        record.write(path)
        return cls(path, plan, record, earlier)

    def kept_records(self) -> dict[str, TrialRecord]:
        """Records by trial name of trials that an earlier run scored in full with the same weights. Raises RunError."""
        if not self.plan.settings.resume:
            return {}
        weights = {trial.name: trial.weights.sha256 if trial.weights else "" for trial in self.plan.trials}
        weights |= {split.oracle_name: "" for split in self.plan.splits if split.test.has_truth}
        records = {name: read_trial_record(self.path / name) for name in weights}
        done = {n: record for n, record in records.items() if record and _is_done(weights[n], record, self.path / n)}
        self.kept.update(done)
        return done

    def finish(self, records: Mapping[str, TrialRecord], notices: Sequence[Notice], interrupted: bool) -> RunSummary:
        """Write and return the summary of these records, by trial name, with `notices`, and close the run.

        The records are the host's own. A trial with a file that another process has changed since counts as failed.
        """
        plan = self.plan
        records = {name: self._with_own_files(name, record) for name, record in records.items()}
        trials = [
            FinishedTrial(
                records[t.name], self.path / t.name, t.selection.name, t.selection.options, t.selection.points
            )
            for t in plan.trials
        ]
        oracles = [name for split in plan.splits if (name := split.oracle_name) in records]
        trials += [FinishedTrial(records[name], self.path / name, ORACLE, {}, "centres") for name in oracles]
        recordings = {split.name: description_of(split) for split in plan.splits}
        all_notices = [*plan.notices, *self._notices_of_versions(records), *notices]
        settings = plan.settings
        by = scores(settings.scores)
        summary = summarise(recordings, trials, all_notices, interrupted, settings.reference, by, settings.headline)
        summary.write(self.path)
        status = "interrupted" if interrupted else "complete"
        self.record.model_copy(update={"status": status, "finished": _now()}).write(self.path)
        return summary

    def _with_own_files(self, name: str, record: TrialRecord) -> TrialRecord:
        changed = record.changed_file(self.path / name)
        if changed is None:
            return record
        reason = (
            f"another process changed {changed.name} after the trial wrote it: run it again with --resume, and with"
            " --sandbox where a tracker may have done it"
        )
        failed = record.model_copy(update={"outcome": "failed", "reason": reason, "frames_scored": 0})
        failed.write(self.path / name)
        return failed

    def _notices_of_versions(self, records: Mapping[str, TrialRecord]) -> list[Notice]:
        """Notices of kept trials that ran with other versions than the current ones, in this run or an earlier one."""
        kept = [
            t.name for t in self.plan.trials if t.name in self.kept and _is_kept(self.kept[t.name], records[t.name])
        ]
        if self.earlier is None or not kept:
            return []
        notices: list[Notice] = []
        with suppress(FileNotFoundError, RunError):
            notices = [notice for notice in read_summary(self.path).notices if notice.kind == OTHER_VERSIONS]
        then, now = _differing(self.earlier.versions, self.record.versions)
        if then:
            text = f"trials kept from a run with {then}: {len(kept)}; now {now}"
            notices.append(Notice(text=text, kind=OTHER_VERSIONS))
        return list(dict.fromkeys(notices))


def _is_kept(kept: TrialRecord, record: TrialRecord) -> bool:
    """Whether a trial did not run again: its times would differ."""
    return record.outcome == "ok" and record.times == kept.times


def _differing(then: Mapping[str, str], now: Mapping[str, str]) -> tuple[str, str]:
    """The differing versions of both, as text; empty if none differ."""
    names = [name for name in sorted(then.keys() | now.keys()) if then.get(name) != now.get(name)]
    old, new = (
        ", ".join(f"{name} {versions[name]}" if name in versions else f"no {name}" for name in names)
        for versions in (then, now)
    )
    return old, new


def refuse_earlier_run(path: Path) -> None:
    """Raise RunError if the folder holds a run, or other files."""
    if _earlier_record(path) is not None:
        raise holds_a_run(path)
    refuse_other_files(path)


def refuse_other_files(path: Path) -> None:
    """Raise RunError if the folder has files, but no run."""
    if not (path / RUN_FILE).exists() and any(not file.name.startswith(".") for file in path.iterdir()):
        raise RunError(f"{path}: has files, but no run: name a new or an empty folder with --out")


def holds_a_run(path: Path | str) -> RunError:
    """The error for a folder, or a URL, that holds a run already."""
    return RunError(f"{path} holds a run already: continue it with --resume, or name another folder with --out")


def _is_done(weights_sha256: str, record: TrialRecord, folder: Path) -> bool:
    whole = (folder / SUMS_FILE).is_file()
    same = record.weights_sha256 == weights_sha256 and record.changed_file(folder) is None
    return whole and record.outcome == "ok" and same


def without_edited(
    plan: ComparisonPlan, kept: Mapping[str, TrialRecord], note: Callable[[str], None]
) -> dict[str, TrialRecord]:
    """The `kept` records by trial name, without trials of a tracker that was edited since; `note` reports them.

    Each tracker of the user is started once to hash its code; trackers of gridtrack are not, because the run records
    its version. The scores of a tracker that no longer starts are kept.
    """
    trials = [trial for trial in plan.trials if trial.name in kept and trial.is_users]
    edited: set[str] = set()
    for label in dict.fromkeys(trial.label for trial in trials):
        own = [trial for trial in trials if trial.label == label]
        now = _current_code(own[0], note)
        other = [trial.name for trial in own if code_differs(kept[trial.name].code_sha256, now)]
        if other:
            note(f"{label}: its code was edited since it ran: {len(other)} of its trials run again")
        edited |= set(other)
    return {name: record for name, record in kept.items() if name not in edited}


def _current_code(trial: Trial, note: Callable[[str], None]) -> str:
    """The hash of the tracker's code; "" if it does not start."""
    with TemporaryDirectory(prefix="gridtrack-code-") as folder:
        try:
            with trial.tracker_process(Path(folder, "stderr.log")) as process:
                return process.description.code_sha256
        except TrialEnded as ended:
            note(f"{trial.label}: its scores are kept, but it does not start now: {ended}")
            return ""


def _new_record(plan: ComparisonPlan, command: Sequence[str]) -> RunRecord:
    """The record of a run that starts now."""
    validations = [split.validation for split in plan.splits if split.validation]
    inputs = {str(split.path): split.test.sha256 for split in plan.splits}
    inputs |= {str(stretch.recording.path): stretch.sha256 for stretch in validations}
    return RunRecord(
        command=tuple(command),
        settings=RunSettings.model_validate(plan.settings.model_dump(mode="json", exclude={"address", "slurm"})),
        configuration=plan.identity(),
        inputs=inputs,
        weights={trial.name: trial.weights.provenance() for trial in plan.trials if trial.weights},
        versions=versions(),
        machine=machine(),
        started=_now(),
        status="running",
    )


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def _earlier_record(path: Path) -> RunRecord | None:
    """The record of a run that is in the folder already. Raises RunError."""
    try:
        return read_run_record(path)
    except FileNotFoundError:
        return None


def _difference(earlier: RunConfiguration, now: RunConfiguration) -> str:
    """The reason, as text, why `now` cannot continue `earlier`, or "": something missing, or the first difference."""
    compared = (
        ("recording", set(earlier.recordings), set(now.recordings)),
        ("tracker", _labels(earlier), _labels(now)),
    )
    for kind, then, requested in compared:
        if missing := sorted(then - requested):
            return f"{kind} '{missing[0]}' was in it and is not requested now"
    return _first_difference(earlier.model_dump(), now.model_dump())


def _labels(configuration: RunConfiguration) -> set[str]:
    return {trial.partition("@")[0] for trial in configuration.trials}


def _first_difference(earlier: Any, now: Any, where: str = "") -> str:
    """The first key at which two configurations differ, and both values; "" if `now` contains all of `earlier`.

    New recordings and trials are no difference; within one of them each key counts.
    """
    if not (isinstance(earlier, dict) and isinstance(now, dict)):
        return f"{where}: then {json.dumps(earlier)[:80]}, now {json.dumps(now)[:80]}" if earlier != now else ""
    keys = earlier.keys() if where in ("", "recordings", "trials") else earlier.keys() | now.keys()
    found = (_first_difference(earlier.get(k), now.get(k), f"{where}.{k}".removeprefix(".")) for k in sorted(keys))
    return next(filter(None, found), "")


@cache
def versions() -> dict[str, str]:
    """Versions of Python and of the installed distributions of DISTRIBUTIONS, read once."""
    found = {"python": platform.python_version()}
    for name in DISTRIBUTIONS:
        with suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found


def machine() -> Machine:
    """The properties of the machine that latency depends on; no host name, no address."""
    return Machine(
        cpu=_cpu_model(),
        cores=usable_cores(),
        memory_gb=round(psutil.virtual_memory().total / 1e9, 1),
        system=f"{platform.system()} {platform.machine()}",
    )


def usable_cores() -> int:
    """Cores that this process may use."""
    return len(psutil.Process().cpu_affinity() or ()) or psutil.cpu_count() or 1


def _cpu_model() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        for line in cpuinfo.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
