"""The local engine: each work in a thread of this process, with the supervised process of its tracker."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Self

from gridtrack.evaluation.engines.engine import Interrupted, RunObserver, Work
from gridtrack.evaluation.engines.scratch import new_scratch, remove_scratch
from gridtrack.evaluation.runs.trial_record import TrialRecord


class LocalEngine:
    """An Engine of `capacity` threads. `observer` receives the progress of the works."""

    def __init__(self, capacity: int, run_folder: Path, observer: RunObserver) -> None:
        """Raises OSError."""
        self.capacity = capacity
        self._run_folder, self._observer = run_folder.absolute(), observer
        self.scratch = new_scratch(self._run_folder)
        self._threads = ThreadPoolExecutor(capacity, "trial")
        self._stop = threading.Event()
        self._futures: list[Future[TrialRecord]] = []
        self._running: set[Work] = set()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:
            self.cancel()
        self._threads.shutdown()
        remove_scratch(self._run_folder)

    def submit(self, works: Sequence[Work]) -> list[Future[TrialRecord]]:
        """Carry out `works`, in their order."""
        self._futures = []
        for work in works:
            self._futures.append(self._threads.submit(self._run, work))
        return self._futures

    def cancel(self) -> None:
        """End the trackers now: works that wait never start, calls that run are interrupted."""
        self._stop.set()
        for future in self._futures:
            future.cancel()
        for work in tuple(self._running):
            work.interrupt()

    def _run(self, work: Work) -> TrialRecord:
        self._running.add(work)
        try:
            return work.run(_LocalMonitor(work.name, self._observer, self._stop))
        finally:
            self._running.discard(work)


class _LocalMonitor:
    """The Monitor of a work in a thread."""

    def __init__(self, name: str, observer: RunObserver, stop: threading.Event) -> None:
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
