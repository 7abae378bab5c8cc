"""A run as a report reads it: its record and its summary, with all recordings pooled shown as one more recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gridtrack.common.errors import GridtrackError
from gridtrack.evaluation.runs.finished import FinishedTrial
from gridtrack.evaluation.runs.result_files import RunError
from gridtrack.evaluation.runs.run_record import RUN_FILE, RunRecord, read_run_record
from gridtrack.evaluation.runs.summary import (
    ALL_RECORDINGS,
    SUMMARY_FILE,
    PooledSummary,
    RunSummary,
    ScopeSummary,
    TrialSummary,
    read_summary,
)
from gridtrack.evaluation.runs.trial_record import read_trial_record

UNDEFINED = "–"
"""Shown where a score is undefined."""


class ReportError(GridtrackError):
    """A run's folder that cannot be reported."""


@dataclass(frozen=True)
class ReportedRun:
    """A run's folder, read; `name` is the run's name on the page.

    Where recordings are pooled, `summary` has all of them together as the first of its recordings.
    """

    path: Path
    name: str
    summary: RunSummary
    record: RunRecord
    pooled: bool = False

    def is_pooled(self, recording: str) -> bool:
        """Whether a recording of the summary is all recordings pooled."""
        return self.pooled and recording == ALL_RECORDINGS

    @property
    def recordings(self) -> tuple[str, ...]:
        """Names of the recordings themselves."""
        return tuple(name for name in self.summary.recordings if not self.is_pooled(name))

    def identity_of(self, recording: str) -> Any:
        """What decides the scores on one recording, its hash among them: equal for runs of the same frames."""
        recordings = self.record.configuration.recordings
        return recordings if self.is_pooled(recording) else recordings.get(recording)

    def trial_folder(self, label: str, recording: str) -> Path:
        """The folder of a trial. Raises ReportError for names that lead out of the run's folder."""
        folder = self.path / f"{label}@{recording}"
        if folder.parent != self.path:
            raise ReportError(f"{self.path / SUMMARY_FILE}: '{label}@{recording}' is not the name of a folder in it")
        return folder

    def code_of(self, label: str) -> tuple[str, ...]:
        """SHA-256 of the code that a tracker's trials ran with, each once, in their order; none where it is not known.

        Raises RunError.
        """
        folders = [self.path / f"{label}@{name}" for name in self.recordings]
        records = [read_trial_record(folder) for folder in folders if folder.parent == self.path]
        return tuple(dict.fromkeys(one.code_sha256 for one in records if one is not None and one.code_sha256))

    def scored_trials(self) -> dict[tuple[str, str], FinishedTrial]:
        """The trials of which something was scored, by label and recording. Raises RunError and ReportError."""
        found = {}
        for label, row in self.summary.trackers.items():
            for name in (name for name in self.recordings if name in row.recordings):
                folder = self.trial_folder(label, name)
                record = read_trial_record(folder)
                if record is None or not record.frames_scored:
                    continue
                if record.steps + 1 != len(self.summary.recordings[name].horizons_s):
                    raise ReportError(f"{folder}: {record.steps} steps, and {SUMMARY_FILE} has others; compare again")
                named = record.model_copy(update={"label": label, "recording": name})
                found[label, name] = FinishedTrial(named, folder, row.tracker, row.options, row.points)
        return found


def read_runs(paths: Sequence[Path]) -> tuple[ReportedRun, ...]:
    """Read several runs' folders; each is named by its folder, or by its whole path where names collide.

    Raises RunError.
    """
    folders = [path.resolve().name for path in paths]
    names = [str(path) if folders.count(name) > 1 else name for path, name in zip(paths, folders, strict=True)]
    return tuple(_read_run(path, name) for path, name in zip(paths, names, strict=True))


def _read_run(path: Path, name: str) -> ReportedRun:
    record, summary = read_results(path)
    pooled = summary.has_pooled
    return ReportedRun(path, name, with_pooled(summary) if pooled else summary, record, pooled)


def read_results(path: Path) -> tuple[RunRecord, RunSummary]:
    """The record and the summary in the folder of a run that has ended, its trials' files checked. Raises RunError."""
    if not path.is_dir():
        raise RunError(f"{path}: there is no such run's folder; `gridtrack compare ... --out RUN` makes one")
    try:
        record = read_run_record(path)
    except FileNotFoundError:
        raise RunError(f"{path} has no {RUN_FILE}: it is not a run's folder") from None
    try:
        summary = read_summary(path)
    except FileNotFoundError:
        raise RunError(f"{path} has no {SUMMARY_FILE}: the run did not finish; continue it with --resume") from None
    for trial in (f"{label}@{name}" for label, row in summary.trackers.items() for name in row.recordings):
        found = read_trial_record(path / trial) if (path / trial).parent == path else None
        if found is not None:
            found.require_own_files(path / trial)
    return record, summary


def with_pooled(summary: RunSummary) -> RunSummary:
    """The summary with all recordings together as the first of its recordings."""
    described = list(summary.recordings.values())
    together = described[0].model_copy(
        update={
            "stretch": f"{len(described)} recordings",
            "horizons_s": summary.pooled_horizons_s or described[0].horizons_s,
            "grid": described[0].grid if len({one.grid for one in described}) == 1 else "",
            "frames": sum(one.frames for one in described),
            "parity": all(one.parity for one in described),
        }
    )
    trackers = {
        label: row.model_copy(update={"recordings": {ALL_RECORDINGS: _as_trial(row.pooled), **row.recordings}})
        for label, row in summary.trackers.items()
        if row.pooled is not None
    }
    return summary.model_copy(
        update={"recordings": {ALL_RECORDINGS: together, **summary.recordings}, "trackers": trackers}
    )


def _as_trial(pooled: PooledSummary) -> TrialSummary:
    """The pooled scores in the form of one trial's: nothing was timed of it."""
    return TrialSummary(**{name: getattr(pooled, name) for name in ScopeSummary.model_fields})
