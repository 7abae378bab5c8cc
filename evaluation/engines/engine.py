"""The interface of an engine, which executes the jobs of a run, the folder in which it works, and the local engine."""

from __future__ import annotations

import shutil
import threading
from abc import ABC, abstractmethod
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from tempfile import mkdtemp
from types import TracebackType
from typing import Any, Protocol, Self, TypeVar

from gridtrack.common.errors import GridtrackError
from gridtrack.evaluation.hosting.limits import SCRATCH

WAKE_S = 0.2
"""Period at which the main thread checks for an interrupt: a library may have made its wait ignore signals."""


class EngineError(GridtrackError):
    """A failure of the engine or its machines, not of the tracker: a job was not executed."""


class Interrupted(Exception):
    """The run was interrupted; the scores so far are kept."""


class JobObserver(Protocol):
    """Receives the progress of all jobs, from several threads. `job` is the name of a job."""

    def note(self, text: str) -> None:
        """A message for the user, one line."""

    def started(self, job: str, frames: int) -> None:
        """A job starts; it will deliver `frames` frames."""

    def advanced(self, job: str) -> None:
        """The next frame is delivered."""


class Monitor:
    """Passes the progress of the job `name` to an observer, and interrupts the job when `stop` is set."""

    def __init__(self, name: str, observer: JobObserver, stop: threading.Event) -> None:
        self._name, self._observer, self._stop = name, observer, stop

    def note(self, text: str) -> None:
        """A message for the user, one line."""
        self._observer.note(text)

    def started(self, frames: int) -> None:
        """The job starts; it will deliver `frames` frames."""
        self._observer.started(self._name, frames)

    def next_frame(self) -> None:
        """The next frame is delivered. Raises Interrupted."""
        self.check()
        self._observer.advanced(self._name)

    def check(self) -> None:
        """Raises Interrupted if the run was interrupted."""
        if self._stop.is_set():
            raise Interrupted


class JobResult(Protocol):
    """The result of a job."""

    @property
    def outcome(self) -> str:
        """`ok`, `interrupted`, or the failure of the tracker."""


Result = TypeVar("Result", bound=JobResult)
Result_co = TypeVar("Result_co", bound=JobResult, covariant=True)


class Job(Protocol[Result_co]):
    """An independent part of a run, which writes files into one folder: the scores of a trial, or a measurement."""

    @property
    def name(self) -> str:
        """The name of the trial, and of its folder in the run's folder."""

    @property
    def replaces(self) -> tuple[str, ...]:
        """Names of files in the folder that the job replaces."""

    @property
    def result_file(self) -> str:
        """The name of the file with the result: it is written last."""

    def order(self) -> str:
        """Its description as JSON, from which a process on another machine makes the same job."""

    def run(self, monitor: Monitor) -> Result_co:
        """Execute it in this process. Raises Interrupted, and an error if there is no result."""

    def result(self) -> Result_co:
        """The result in the file that another process has written. Raises GridtrackError."""

    def interrupt(self) -> None:
        """End it from another thread, also during a call."""


class Engine(ABC):
    """Executes jobs, at most `capacity` at the same time. A context manager: leaving it ends everything it started.

    `observer` receives the progress of the jobs.
    """

    def __init__(self, capacity: int, run_folder: Path, observer: JobObserver) -> None:
        """Removes the scratch folder of a killed run. Raises OSError."""
        self.capacity, self._run_folder, self._observer = capacity, run_folder.absolute(), observer
        remove_scratch(self._run_folder)
        (self._run_folder / SCRATCH).mkdir(exist_ok=True)
        self.scratch = Path(mkdtemp(dir=self._run_folder / SCRATCH))
        """A folder that all its processes can read, removed when the engine is left."""

    @abstractmethod
    def submit(self, jobs: Sequence[Job[Result]]) -> list[Future[Result]]:
        """Execute `jobs` in any order. Each future gets the job's result, or the error that ended it."""

    @abstractmethod
    def cancel(self) -> None:
        """End all jobs: waiting jobs never start, running ones are interrupted and return the result so far."""

    def __enter__(self) -> Self:
        return self

    @abstractmethod
    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


def remove_scratch(run_folder: Path) -> None:
    """Remove the scratch folder, as far as possible."""
    shutil.rmtree(run_folder / SCRATCH, ignore_errors=True)


class LocalEngine(Engine):
    """An Engine of threads."""

    def __init__(self, capacity: int, run_folder: Path, observer: JobObserver) -> None:
        """Raises OSError."""
        super().__init__(capacity, run_folder, observer)
        self._threads = ThreadPoolExecutor(capacity, "trial")
        self._stop = threading.Event()
        self._futures: list[Future[Any]] = []
        self._running: set[Job[Any]] = set()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:
            self.cancel()
        self._threads.shutdown()
        remove_scratch(self._run_folder)

    def submit(self, jobs: Sequence[Job[Result]]) -> list[Future[Result]]:
        """Execute `jobs` in their order."""
        futures: list[Future[Result]] = []
        self._futures = futures
        for job in jobs:
            futures.append(self._threads.submit(self._run, job))
        return futures

    def cancel(self) -> None:
        """End all jobs: waiting jobs never start, and running calls of trackers are interrupted."""
        self._stop.set()
        for future in self._futures:
            future.cancel()
        for job in tuple(self._running):
            job.interrupt()

    def _run(self, job: Job[Result]) -> Result:
        self._running.add(job)
        try:
            return job.run(Monitor(job.name, self._observer, self._stop))
        finally:
            self._running.discard(job)
