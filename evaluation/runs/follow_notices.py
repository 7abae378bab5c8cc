"""Notices of a run that followed its recording: how it ended, and which trackers did not keep up."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from gridtrack.evaluation.results.trial_record import TrialRecord


@dataclass(frozen=True, slots=True)
class Ending:
    """How the following of the recording at `path` ended, `at_s` seconds after its first frame."""

    path: Path
    at_s: float
    frames_before: int
    """Frames that were written before it began."""
    problem: str
    """Why the rest of the recording cannot be read; empty where it can."""
    interrupted: bool
    idle: bool
    limit: int | None
    """Bytes that were read, where the recorder had not closed the file."""
    table_problem: str
    """Why the live table lacks scores; empty where it does not."""
    delivered: str
    """Hash of the frames that were presented."""


def follow_notices(ending: Ending, records: Iterable[TrialRecord]) -> list[str]:
    """The notices of the run, one line each."""
    return [*_about_the_end(ending), *(line for record in records for line in _about_a_trial(record, ending))]


def _about_the_end(ending: Ending) -> Iterator[str]:
    path, ended = ending.path, f"{ending.path}: ended at {ending.at_s:.1f} s"
    if ending.frames_before:
        yield f"{path}: the first {ending.frames_before} frames, written before the following began, have no deadline"
    if ending.problem:
        yield f"{ended}: {ending.problem}"
    elif ending.interrupted:
        yield f"{ended} by Ctrl-C"
    elif ending.idle:
        yield f"{ended}: nothing was written to it for --idle-timeout"
    if ending.limit is not None:
        yield f"{path}: its recorder had not closed it: its first {ending.limit} bytes were read"
    if ending.table_problem:
        yield f"the live table lacks scores: {ending.table_problem}"


def _about_a_trial(record: TrialRecord, ending: Ending) -> Iterator[str]:
    followed = record.followed
    if followed and followed.missed and followed.age_frames:
        yield (
            f"{record.label} missed {followed.missed} of {followed.frames} frames with a deadline; its newest forecast"
            f" in time was {followed.age_frames.p99:g} frames old at the 99th percentile"
        )
    if record.complete and record.delivered != ending.delivered:
        yield f"{record.label} received other frames than those that it was scored on"
