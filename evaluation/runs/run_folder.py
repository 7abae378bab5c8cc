"""A run's folder while it is filled: its record, the folders of its trials, and its summary."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from gridtrack.evaluation.results.columns import HISTOGRAM_TABLE, SCORES_TABLE
from gridtrack.evaluation.results.files import RunError
from gridtrack.evaluation.results.run_record import RUN_FILE, RunConfiguration, RunRecord, RunSettings, read_run_record
from gridtrack.evaluation.results.summary import ORACLE, RunSummary, read_summary
from gridtrack.evaluation.results.trial_record import TrialRecord, read_trial_record
from gridtrack.evaluation.runs.plan import ComparisonPlan
from gridtrack.evaluation.runs.provenance import machine, versions
from gridtrack.evaluation.statistics.finished_trial import FinishedTrial
from gridtrack.evaluation.statistics.summary import summarise

OF_OTHER_VERSIONS = "trials kept from a run with"
"""In the notice of a resumed run that says so, and that every further one keeps."""


@dataclass(frozen=True, slots=True)
class RunFolder:
    """The folder of one run while it is filled."""

    path: Path
    plan: ComparisonPlan
    record: RunRecord
    earlier: RunRecord | None = None
    """That of the run which is continued."""
    kept: dict[str, TrialRecord] = field(default_factory=dict)
    """What `kept_records` has found."""

    @classmethod
    def prepare(cls, plan: ComparisonPlan, command: Sequence[str]) -> RunFolder:
        """Start a run in the folder, or with `resume` continue an earlier one.

        What is compared may have got more trackers and recordings since; nothing else may differ. The folder exists
        and is locked (`run_lock`). Raises RunError where it holds another run.
        """
        path = plan.settings.out
        record = _new_record(plan, command)
        earlier = _earlier_record(path)
        if earlier is not None and not plan.settings.resume:
            raise holds_a_run(path)
        changed = _what_changed(earlier.configuration, record.configuration) if earlier else ""
        if changed:
            raise RunError(
                f"{path} holds a run of another configuration ({changed}): name another folder with --out, or repeat"
                f" its command (`command` in {RUN_FILE})"
            )
        record.write(path)
        return cls(path, plan, record, earlier)

    def kept_records(self) -> dict[str, TrialRecord]:
        """Records by trial name of what an earlier run scored in full with the same weights. Raises RunError."""
        if not self.plan.settings.resume:
            return {}
        weights = {trial.name: trial.weights.sha256 if trial.weights else "" for trial in self.plan.trials}
        weights |= {split.oracle_name: "" for split in self.plan.splits if split.test.has_truth}
        records = {name: read_trial_record(self.path / name) for name in weights}
        done = {n: record for n, record in records.items() if record and _is_done(weights[n], record, self.path / n)}
        self.kept.update(done)
        return done

    def finish(self, records: Mapping[str, TrialRecord], notices: Sequence[str], interrupted: bool) -> RunSummary:
        """Write and return the summary of these records, by trial name, with `notices`, and close the run."""
        plan = self.plan
        trials = [
            FinishedTrial(
                records[t.name], self.path / t.name, t.selection.name, t.selection.options, t.selection.points
            )
            for t in plan.trials
        ]
        oracles = [name for split in plan.splits if (name := split.oracle_name) in records]
        trials += [FinishedTrial(records[name], self.path / name, ORACLE, {}, "centres") for name in oracles]
        recordings = {split.name: split.description() for split in plan.splits}
        told = [*plan.notices, *self._of_other_versions(records), *notices]
        summary = summarise(recordings, trials, told, interrupted, plan.settings.reference)
        summary.write(self.path)
        status = "interrupted" if interrupted else "complete"
        self.record.model_copy(update={"status": status, "finished": _now()}).write(self.path)
        return summary

    def _of_other_versions(self, records: Mapping[str, TrialRecord]) -> list[str]:
        """Notices of the trials among `records` that ran with other versions than those of now, or of a run before."""
        kept = [
            t.name for t in self.plan.trials if t.name in self.kept and _is_kept(self.kept[t.name], records[t.name])
        ]
        if self.earlier is None or not kept:
            return []
        told: list[str] = []
        with suppress(FileNotFoundError, RunError):
            told = [notice for notice in read_summary(self.path).notices if OF_OTHER_VERSIONS in notice]
        then, now = _differing(self.earlier.versions, self.record.versions)
        if then:
            told.append(f"{OF_OTHER_VERSIONS} {then}: {len(kept)}; now {now}")
        return list(dict.fromkeys(told))


def _is_kept(kept: TrialRecord, record: TrialRecord) -> bool:
    """Whether a trial did not run again: it would have taken another time."""
    return record.outcome == "ok" and record.times == kept.times


def _differing(then: Mapping[str, str], now: Mapping[str, str]) -> tuple[str, str]:
    """The versions that differ, in words, of both; "" where none does, or those of `then` are not known."""
    names = [name for name in sorted(then.keys() | now.keys()) if then and then.get(name) != now.get(name)]
    told = [
        ", ".join(f"{name} {versions[name]}" if name in versions else f"no {name}" for name in names)
        for versions in (then, now)
    ]
    return told[0], told[1]


def refuse_earlier_run(path: Path) -> None:
    """Raise RunError where the folder holds a run, or files of something else."""
    if _earlier_record(path) is not None:
        raise holds_a_run(path)
    refuse_other_files(path)


def refuse_other_files(path: Path) -> None:
    """Raise RunError where the folder has files, but no run."""
    if not (path / RUN_FILE).exists() and any(not file.name.startswith(".") for file in path.iterdir()):
        raise RunError(f"{path}: has files, and none of a run: name a new or an empty folder with --out")


def holds_a_run(path: Path | str) -> RunError:
    """The error of a folder, or a URL, at which a run cannot begin."""
    return RunError(f"{path} holds a run already: continue it with --resume, or name another folder with --out")


def _is_done(weights_sha256: str, record: TrialRecord, folder: Path) -> bool:
    whole = all((folder / table.file).is_file() for table in (SCORES_TABLE, HISTOGRAM_TABLE))
    same = record.weights_sha256 == weights_sha256 and record.changed_file(folder) is None
    return whole and record.outcome == "ok" and same


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


def _what_changed(earlier: RunConfiguration, now: RunConfiguration) -> str:
    """What keeps `now` from continuing `earlier`, in words, or "": something left out, or the first difference."""
    compared = (
        ("recording", set(earlier.recordings), set(now.recordings)),
        ("tracker", _labels(earlier), _labels(now)),
    )
    for what, then, requested in compared:
        if left := sorted(then - requested):
            return f"{what} '{left[0]}' was in it and is not requested now"
    return _first_difference(earlier.model_dump(), now.model_dump())


def _labels(configuration: RunConfiguration) -> set[str]:
    return {trial.partition("@")[0] for trial in configuration.trials}


def _first_difference(earlier: Any, now: Any, where: str = "") -> str:
    """The key at which two configurations differ first, and both values; "" where `now` has all of `earlier`.

    Recordings and trials that are new are no difference; within one of them each key counts.
    """
    if not (isinstance(earlier, dict) and isinstance(now, dict)):
        return f"{where}: then {json.dumps(earlier)[:80]}, now {json.dumps(now)[:80]}" if earlier != now else ""
    keys = earlier.keys() if where in ("", "recordings", "trials") else earlier.keys() | now.keys()
    found = (_first_difference(earlier.get(k), now.get(k), f"{where}.{k}".removeprefix(".")) for k in sorted(keys))
    return next(filter(None, found), "")
