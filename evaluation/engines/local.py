"""The local engine: each job in a thread of this process, beside the supervised process of its tracker."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from gridtrack.evaluation.engines.engine import Interrupted, Job, JobObserver, Result, new_scratch, remove_scratch


class LocalEngine:
    """An Engine of `capacity` threads. `observer` receives the progress of the jobs."""

    def __init__(self, capacity: int, run_folder: Path, observer: JobObserver) -> None:
        """Raises OSError."""
        self.capacity = capacity
        self._run_folder, self._observer = run_folder.absolute(), observer
        self.scratch = new_scratch(self._run_folder)
        self._threads = ThreadPoolExecutor(capacity, "trial")
        self._stop = threading.Event()
        self._futures: list[Future[Any]] = []
        self._running: set[Job[Any]] = set()

    def __enter__(self) -> Self:
        return self

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
            return job.run(_LocalMonitor(job.name, self._observer, self._stop))
        finally:
            self._running.discard(job)


class _LocalMonitor:
    """The Monitor of a job in a thread."""

    def __init__(self, name: str, observer: JobObserver, stop: threading.Event) -> None:
        self._name, self._observer, self._stop = name, observer, stop

    def note(self, text: str) -> None:
        self._observer.note(text)

    def started(self, frames: int) -> None:
        self._observer.started(self._name, frames)

    def next_frame(self) -> None:
        self.check()
        self._observer.advanced(self._name)

    def check(self) -> None:
        if self._stop.is_set():
            raise Interrupted
