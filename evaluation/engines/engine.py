"""The engine: it carries out the works of a run, and gives the record of the trial that each is about."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

from gridtrack.evaluation.runs.trial_record import TrialRecord

WAKE_S = 0.2
"""Period at which the main thread checks for an interrupt: a library may have made its wait ignore signals."""


class Interrupted(Exception):
    """The run was interrupted; the scores so far are kept."""


class RunObserver(Protocol):
    """Receives the progress of a run, from several threads; a trial is named like its folder."""

    def note(self, text: str) -> None:
        """A message for the user, one line."""

    def planned(self, frames: Mapping[str, int], then: Sequence[str] = ()) -> None:
        """The trials that will run, and about how many frames each will receive; `then`: what follows them."""

    def started(self, trial: str, frames: int) -> None:
        """A trial starts; it will receive `frames` frames."""

    def advanced(self, trial: str) -> None:
        """The next frame is delivered."""

    def ended(self, trial: str, record: TrialRecord) -> None:
        """A trial has ended, or its record is kept from an earlier run."""


class Monitor(Protocol):
    """Receives the progress of one work, and ends it where the run is interrupted."""

    def note(self, text: str) -> None:
        """A message for the user, one line."""

    def started(self, frames: int) -> None:
        """The work starts; it will deliver `frames` frames."""

    def next_frame(self) -> None:
        """The next frame is delivered. Raises Interrupted."""

    def check(self) -> None:
        """Raises Interrupted where the run is interrupted."""


class Work(Protocol):
    """A part of a run that is about one trial, and that runs on its own: its scores, or a measurement after them."""

    @property
    def name(self) -> str:
        """The name of the trial, and of its folder."""

    @property
    def replaces(self) -> tuple[str, ...]:
        """Names of the files of an earlier run in the trial's folder that it replaces."""

    def order(self) -> str:
        """Its description as a JSON text, from which a process on another machine makes the same work."""

    def run(self, monitor: Monitor) -> TrialRecord:
        """Do it, and give the trial's record. Raises Interrupted, and an error where there is no record."""

    def interrupt(self) -> None:
        """End it from another thread, also during a call."""


class Engine(Protocol):
    """Where works are carried out. A context manager: leaving it ends everything that it started."""

    capacity: int
    """The number of works that can run at the same time; 0 where none can."""
    scratch: Path
    """A folder that all its processes can read, removed when the engine is left."""

    def submit(self, works: Sequence[Work]) -> list[Future[TrialRecord]]:
        """Carry out `works` in any order; the future of each has its record, or the error that ended it."""

    def cancel(self) -> None:
        """End all works: those that wait never start, those that run are interrupted and give the record so far."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...
