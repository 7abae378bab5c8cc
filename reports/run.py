"""A run for a report: its record and its summary, in which all recordings pooled are one more recording."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cached_property
from pathlib import Path
from typing import Any

from gridtrack.common.errors import ConfigurationError, GridtrackError, did_you_mean
from gridtrack.common.files import refuse_links
from gridtrack.evaluation.hosting.limits import SCRATCH
from gridtrack.evaluation.runs.finished import FinishedTrial
from gridtrack.evaluation.runs.result_files import Curve, RunError
from gridtrack.evaluation.runs.run_record import RUN_FILE, RunRecord, read_run_record
from gridtrack.evaluation.runs.summary import (
    ALL_RECORDINGS,
    SUMMARY_FILE,
    Estimate,
    Estimates,
    OutputDescription,
    RunSummary,
    ScopeSummary,
    ScoreDescription,
    TrackerDifference,
    TrackerSummary,
    TrialSummary,
    read_summary,
)
from gridtrack.evaluation.runs.trial_record import read_trial_record

UNDEFINED = "–"
"""Shown if a score is undefined."""
THRESHOLD = ScoreDescription(
    name="threshold",
    title="Threshold",
    about="Cells with at least this probability are called occupied.",
    thresholded=False,
    outputs=(OutputDescription(name="threshold", title="Threshold"),),
)
"""The threshold of each step, which is shown like a score."""


class ReportError(GridtrackError):
    """The folder of a run cannot be reported."""


@dataclass(frozen=True)
class ReportedRun:
    """The content of a run's folder; `name`: on the page; `summary`: a `shown_summary`."""

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

    @cached_property
    def has_site_weights(self) -> bool:
        """Whether a tracker has weights of the site of a recording."""
        rows = (row for row in self.summary.trackers.values() if not row.floor)
        return any("site" in trial.card for row in rows for trial in row.recordings.values())

    def differences_on(self, recording: str) -> list[TrackerDifference]:
        """The comparisons of trackers with a reference on a recording, or on all pooled."""
        return [one for one in self.summary.differences if one.recordings == recording]

    def identity_of(self, recording: str) -> Any:
        """The settings and hash of one recording, equal for runs of the same frames."""
        recordings = self.record.configuration.recordings
        return recordings if self.is_pooled(recording) else recordings.get(recording)

    def trial_folder(self, label: str, recording: str) -> Path:
        """The folder of a trial. Raises ReportError for names that lead out of the run's folder."""
        folder = self.path / f"{label}@{recording}"
        if folder.parent != self.path:
            raise ReportError(f"{self.path / SUMMARY_FILE}: '{label}@{recording}' is not the name of a folder in it")
        return folder

    def code_of(self, label: str) -> tuple[str, ...]:
        """SHA-256 of the code of a tracker's trials, each once, in their order; none if it is not known.

        Raises RunError.
        """
        folders = [self.path / f"{label}@{name}" for name in self.recordings]
        records = [read_trial_record(folder) for folder in folders if folder.parent == self.path]
        return tuple(dict.fromkeys(one.code_sha256 for one in records if one is not None and one.code_sha256))

    def scored_trials(self) -> dict[tuple[str, str], FinishedTrial]:
        """The trials with scored frames, by label and recording. Raises RunError and ReportError."""
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
    """Read several runs' folders; each is named by its folder, or by its whole path if names collide.

    Raises RunError.
    """
    folders = [path.resolve().name for path in paths]
    names = [str(path) if folders.count(name) > 1 else name for path, name in zip(paths, folders, strict=True)]
    return tuple(_read_run(path, name) for path, name in zip(paths, names, strict=True))


def _read_run(path: Path, name: str) -> ReportedRun:
    record, summary = read_results(path)
    return ReportedRun(path, name, shown_summary(summary), record, summary.has_pooled)


def read_results(path: Path) -> tuple[RunRecord, RunSummary]:
    """The record and the summary in the folder of a run that has ended, its trials' files checked. Raises RunError."""
    if not path.is_dir():
        raise RunError(f"{path}: there is no such run's folder; `gridtrack compare ... --out RUN` makes one")
    refuse_links(path, RunError, unread=SCRATCH)
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


def shown_summary(summary: RunSummary) -> RunSummary:
    """The summary with thresholds as one more score, and pooled recordings as its first recording."""
    pooled = summary.has_pooled
    trackers = {label: _shown_row(row, pooled) for label, row in summary.trackers.items()}
    scores = (*summary.scores, THRESHOLD) if summary.scores else ()
    return summary.model_copy(
        update={
            "scores": scores,
            "recordings": ({ALL_RECORDINGS: _together(summary)} if pooled else {}) | summary.recordings,
            "trackers": trackers,
        }
    )


def _together(summary: RunSummary) -> Any:
    """The description of all recordings."""
    described = list(summary.recordings.values())
    return described[0].model_copy(
        update={
            "stretch": f"{len(described)} recordings",
            "horizons_s": summary.pooled_horizons_s or described[0].horizons_s,
            "grid": described[0].grid if len({one.grid for one in described}) == 1 else "",
            "frames": sum(one.frames for one in described),
            "parity": all(one.parity for one in described),
        }
    )


def _shown_row(row: TrackerSummary, pooled: bool) -> TrackerSummary:
    trials = dict(row.recordings)
    if pooled and row.pooled is not None:  # it has no times
        fields = {name: getattr(row.pooled, name) for name in ScopeSummary.model_fields}
        trials = {ALL_RECORDINGS: TrialSummary(**fields), **trials}
    return row.model_copy(update={"recordings": {name: _with_thresholds(trial) for name, trial in trials.items()}})


def _with_thresholds(trial: TrialSummary) -> TrialSummary:
    strata = {name: scores | _threshold(trial.thresholds.get(name, ())) for name, scores in trial.strata.items()}
    return trial.model_copy(update={"strata": strata})


def _threshold(curve: Curve) -> Estimates:
    known = any(value is not None for value in curve)
    return {THRESHOLD.name: {THRESHOLD.lead.name: Estimate(value=curve)}} if known else {}


def chosen_runs(runs: Sequence[ReportedRun], recordings: str) -> tuple[ReportedRun, ...]:
    """The runs with only the recordings that match one of `recordings`, not pooled; runs without any are left out.

    `recordings`: patterns like file names, separated by commas; empty: the runs as they are. Raises ConfigurationError
    for a pattern that matches nothing.
    """
    if not recordings:
        return tuple(runs)
    names = list(dict.fromkeys(name for run in runs for name in run.recordings))
    chosen = names_matching(recordings, names, "--recordings", "recording")
    return tuple(_with_recordings(run, chosen) for run in runs if chosen.intersection(run.recordings))


def _with_recordings(run: ReportedRun, chosen: Set[str]) -> ReportedRun:
    described = {name: one for name, one in run.summary.recordings.items() if name in chosen}
    trackers = {
        label: row.model_copy(update={"recordings": {name: row.recordings[name] for name in own}, "pooled": None})
        for label, row in run.summary.trackers.items()
        if (own := [name for name in described if name in row.recordings])
    }
    others = run.summary.recordings.keys() - chosen
    notices = tuple(notice for notice in run.summary.notices if notice.recording not in others)
    summary = run.summary.model_copy(update={"recordings": described, "trackers": trackers, "notices": notices})
    return replace(run, summary=summary, pooled=False)


def names_matching(patterns: str, names: Collection[str], option: str, noun: str) -> set[str]:
    """The `names` that match one of `patterns`, which are like file names and separated by commas.

    Raises ConfigurationError for a pattern that matches nothing; its message has the `option` and the names' `noun`.
    """
    found: set[str] = set()
    for pattern in (part.strip() for part in patterns.split(",")):
        matching = {name for name in names if fnmatchcase(name, pattern)}
        if not matching:
            raise ConfigurationError(f"{option} '{pattern}': no such {noun}: {did_you_mean(pattern, names)}")
        found |= matching
    return found


def output_name(score: ScoreDescription, output: OutputDescription) -> str:
    """The name of an output in options and columns: `f1` for the leading output, else `f1.recall`."""
    return score.name if output.name == score.lead.name else f"{score.name}.{output.name}"


def scores_of(runs: Sequence[ReportedRun]) -> dict[str, ScoreDescription]:
    """The scores of all runs by name, each in its place in the first run with it."""
    found: Mapping[str, ScoreDescription] = {
        score.name: score for run in reversed(runs) for score in run.summary.scores
    }
    order = dict.fromkeys(score.name for run in runs for score in run.summary.scores)
    return {name: found[name] for name in order}
