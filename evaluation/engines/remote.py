"""The engine of a cluster: each work an attempt on some machine, again on another where a machine is lost."""

from __future__ import annotations

import shutil
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Generic, Self

from gridtrack.evaluation.engines.attempt import INTERRUPTED, Attempt, AttemptProgress, EngineError, Reply
from gridtrack.evaluation.engines.cluster import Task, TaskCluster, TaskEnd
from gridtrack.evaluation.engines.engine import RunObserver, Work
from gridtrack.evaluation.engines.scratch import new_scratch, remove_scratch
from gridtrack.evaluation.runs.trial_record import TrialRecord

"""The folder in the run's folder for what host and machines exchange; removed at the end of the run."""
LOOK_S = 0.5
RETRIES = 2
"""How often a work starts again after its machine was lost."""
CANCEL_S = 60.0
"""Time for interrupted tasks to reply; then they are ended."""
REPLY_S = 60.0
"""Time for a reply to be seen here: network file systems keep the entries of a folder for half a minute."""


@dataclass(slots=True)
class _Submitted:
    """A work that has been submitted: its future, and its current attempt."""

    number: int
    work: Work
    attempt: Attempt
    future: Future[TrialRecord] = field(default_factory=Future)
    attempts: int = 0
    seen: AttemptProgress = field(default_factory=AttemptProgress)
    ended_s: float | None = None
    """When its task was seen to have ended without a reply."""


class RemoteEngine(Generic[Task]):
    """An Engine of the machines of a cluster. They share the run's folder, at the same path.

    A thread watches the tasks. Each attempt has a folder of its own, so what an attempt on a lost machine still writes
    changes no result.
    """

    def __init__(self, cluster: TaskCluster[Task], run_folder: Path, observer: RunObserver) -> None:
        """Raises EngineError where no machine of the cluster can run a work, OSError."""
        if cluster.capacity < 1:
            with suppress(EngineError):
                cluster.close()
            raise EngineError(f"{cluster.name}: no machine of the cluster has the cores for one trial: lower --threads")
        self.capacity = cluster.capacity
        self._cluster, self._run_folder, self._observer = cluster, run_folder.absolute(), observer
        self.scratch = new_scratch(self._run_folder)
        self._lock = threading.Lock()
        self._running: dict[Task, _Submitted] = {}
        self._count = 0
        self._cancelled_s: float | None = None
        self._problems: set[str] = set()
        self._closed = threading.Event()
        self._watcher = threading.Thread(target=self._watch, name="engine", daemon=True)
        self._watcher.start()
        observer.note(f"engine {cluster.name}: at most {self.capacity} trials at the same time")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._closed.set()
            self._watcher.join()
            with self._lock:
                self._cancel(self._running, force=True)
            with self._telling():
                self._cluster.close()
        finally:
            remove_scratch(self._run_folder)

    def submit(self, works: Sequence[Work]) -> list[Future[TrialRecord]]:
        """Start an attempt at each of `works`. Raises EngineError, OSError."""
        entries = []
        for work in works:
            self._count += 1
            entries.append(_Submitted(self._count, work, Attempt(self.scratch)))
        with self._lock:
            self._start(entries)
        return [entry.future for entry in entries]

    def cancel(self) -> None:
        """Interrupt all tasks; each has CANCEL_S to give the record so far."""
        with self._lock:
            self._cancelled_s = time.monotonic()
            self._cancel(self._running, force=False)

    def _cancel(self, tasks: Iterable[Task], *, force: bool) -> None:
        with self._telling():
            self._cluster.cancel(tasks, force=force)

    @contextmanager
    def _telling(self) -> Iterator[None]:
        """Tell the user once, and go on, where the cluster does not end what runs: the results so far are kept."""
        try:
            yield
        except EngineError as error:
            if str(error) not in self._problems:
                self._problems.add(str(error))
                self._observer.note(str(error))

    def _start(self, entries: Sequence[_Submitted]) -> None:
        for entry in entries:
            entry.attempts += 1
            folder = self.scratch / f"{entry.number}.{entry.attempts}"
            entry.attempt = Attempt.begin(folder, entry.work.order())
            entry.seen, entry.ended_s = AttemptProgress(), None
        tasks = self._cluster.start([entry.attempt.folder for entry in entries])
        self._running.update(zip(tasks, entries, strict=True))

    def _watch(self) -> None:
        """Until the engine is left, take what has ended; an error here ends every work with it."""
        while not self._closed.wait(LOOK_S):
            try:
                with self._lock:
                    self._look()
            except Exception as error:  # noqa: BLE001 it is raised again where the runner asks for the records
                with self._lock:
                    for entry in self._running.values():
                        if not entry.future.done():
                            entry.future.set_exception(error)
                    self._running.clear()

    def _look(self) -> None:
        ends = self._cluster.ended(list(self._running)) if self._running else {}
        for task, entry in list(self._running.items()):
            try:
                self._relay(entry)
                done = task in ends and self._end(entry, ends[task])
            except EngineError as error:
                entry.future.set_exception(error)
                self._cancel([task], force=True)
                done = True
            if done:
                del self._running[task]
        if self._cancelled_s is not None and time.monotonic() > self._cancelled_s + CANCEL_S:
            self._cancel(self._running, force=True)
            for entry in self._running.values():
                _end_as_cancelled(entry.future)
            self._running.clear()

    def _relay(self, entry: _Submitted) -> None:
        """Tell the observer what is new in the progress of an attempt."""
        seen, now = entry.seen, entry.attempt.progress()
        for note in now.notes[len(seen.notes) :]:
            self._observer.note(note)
        if now.frames is not None and seen.frames is None:
            self._observer.started(entry.work.name, now.frames)
        if now.frames is not None:
            for _ in range(now.delivered - seen.delivered):
                self._observer.advanced(entry.work.name)
        entry.seen = now

    def _end(self, entry: _Submitted, end: TaskEnd) -> bool:
        """Take what a task left that has ended; whether that is all there will be."""
        reply = entry.attempt.reply()
        cancelled = self._cancelled_s is not None
        if reply is not None and (cancelled or not _ended_from_outside(reply, end)):
            self._relay(entry)
            self._accept(entry, reply)
        elif cancelled:
            _end_as_cancelled(entry.future)
        elif reply is None and not end.lost and not end.reason and not self._waited(entry):
            return False
        elif end.lost or reply is not None:
            self._retry(entry, end.reason or "it was interrupted")
        else:
            entry.future.set_exception(EngineError(end.reason or "it ended without a reply"))
        return True

    def _waited(self, entry: _Submitted) -> bool:
        """Whether the reply of a task that ended well has had its time to be seen."""
        entry.ended_s = entry.ended_s or time.monotonic()
        return time.monotonic() >= entry.ended_s + REPLY_S

    def _accept(self, entry: _Submitted, reply: Reply) -> None:
        entry.attempt.move_files(self._run_folder / entry.work.name, entry.work.replaces)
        shutil.rmtree(entry.attempt.folder, ignore_errors=True)
        if reply.record is not None:
            entry.future.set_result(reply.record)
        elif reply.error == INTERRUPTED:
            _end_as_cancelled(entry.future)
        else:
            entry.future.set_exception(EngineError(reply.error))

    def _retry(self, entry: _Submitted, reason: str) -> None:
        """Start a work again whose machine was lost, or end it where that has happened too often."""
        shutil.rmtree(entry.attempt.folder, ignore_errors=True)
        name = entry.work.name
        if entry.attempts > RETRIES:
            error = f"lost by the engine {entry.attempts} times, the last time because {reason}: compare with --resume"
            entry.future.set_exception(EngineError(error))
            return
        self._observer.note(f"{name}: lost by the engine ({reason}); starts again, {entry.attempts} of {RETRIES}")
        self._start([entry])


def _end_as_cancelled(future: Future[TrialRecord]) -> None:
    """End a future without a record; one that is only cancelled, and not notified, would be waited for without end."""
    if future.cancel():
        future.set_running_or_notify_cancel()


def _ended_from_outside(reply: Reply, end: TaskEnd) -> bool:
    """Whether something other than its tracker or an error ended the work.

    What takes a machine away ends trackers too, maybe before the process that would tell the one from the other.
    """
    outcome = reply.record.outcome if reply.record is not None else ""
    return INTERRUPTED in {reply.error, outcome} or (end.lost and outcome != "ok")
