"""The engine of a cluster: each job as a task on some machine, again on another one if a machine is lost."""

from __future__ import annotations

import shutil
import threading
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

from gridtrack.common.errors import GridtrackError
from gridtrack.evaluation.engines.engine import Engine, EngineError, Job, JobObserver, Result, remove_scratch
from gridtrack.evaluation.engines.task import INTERRUPTED, Reply, TaskFolder, TaskProgress

Task = TypeVar("Task")
POLL_S = 0.5
RETRIES = 2
"""How often a job starts again after its machine was lost."""
CANCEL_S = 60.0
"""Time for interrupted tasks to reply; then they are killed."""
REPLY_S = 60.0
"""Time for a reply to become visible here: network file systems cache the entries of a folder for half a minute."""


class TaskEnd(NamedTuple):
    """The end of a task. `lost`: with its machine or its process, so the job may run again."""

    lost: bool
    reason: str


class TaskCluster(Protocol[Task]):
    """Runs tasks on its machines, each in a folder that all of them share."""

    name: str
    capacity: int
    """The number of tasks that its machines can run at the same time."""

    def start(self, folders: Sequence[Path]) -> list[Task]:
        """Start the tasks in `folders`. Raises EngineError."""

    def ended(self, tasks: Sequence[Task]) -> Mapping[Task, TaskEnd]:
        """The tasks among `tasks` that have ended. Raises EngineError if the cluster is lost."""

    def cancel(self, tasks: Iterable[Task], *, force: bool) -> None:
        """End `tasks`: by an interrupt, after which they may reply, or with `force` at once.

        Raises EngineError, with the jobs that may still run, if the cluster does not answer.
        """

    def close(self) -> None:
        """Leave the cluster. Raises EngineError as `cancel`."""


@dataclass(slots=True)
class _Submitted:
    """A submitted job: its future, and its current task."""

    number: int
    job: Job[Any]
    folder: TaskFolder
    future: Future[Any] = field(default_factory=Future)
    starts: int = 0
    seen: TaskProgress = field(default_factory=TaskProgress)
    ended_s: float | None = None
    """When the end of its task without a reply was noticed."""


class RemoteEngine(Engine, Generic[Task]):
    """An Engine of the machines of a cluster. They share the run's folder, at the same path.

    A thread watches the tasks. Each task has its own folder, so a task on a lost machine that still writes changes no
    result.
    """

    def __init__(self, cluster: TaskCluster[Task], run_folder: Path, observer: JobObserver) -> None:
        """Raises EngineError if no machine of the cluster can run a job, OSError."""
        if cluster.capacity < 1:
            with suppress(EngineError):
                cluster.close()
            raise EngineError(f"{cluster.name}: no machine of the cluster has the cores for one trial: lower --threads")
        super().__init__(cluster.capacity, run_folder, observer)
        self._cluster = cluster
        self._lock = threading.Lock()
        self._running: dict[Task, _Submitted] = {}
        self._count = 0
        self._cancelled_s: float | None = None
        self._problems: set[str] = set()
        self._closed = threading.Event()
        self._watcher = threading.Thread(target=self._watch, name="engine", daemon=True)
        self._watcher.start()
        observer.note(f"engine {cluster.name}: at most {self.capacity} trials at the same time")

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._closed.set()
            self._watcher.join()
            with self._lock:
                self._cancel(self._running, force=True)
            with self._noting_errors():
                self._cluster.close()
        finally:
            remove_scratch(self._run_folder)

    def submit(self, jobs: Sequence[Job[Result]]) -> list[Future[Result]]:
        """Start a task for each of `jobs`. Raises EngineError, OSError."""
        entries = []
        for job in jobs:
            self._count += 1
            entries.append(_Submitted(self._count, job, TaskFolder(self.scratch)))
        with self._lock:
            self._start(entries)
        return [entry.future for entry in entries]

    def cancel(self) -> None:
        """Interrupt all tasks; each has CANCEL_S to return the result so far."""
        with self._lock:
            self._cancelled_s = time.monotonic()
            self._cancel(self._running, force=False)

    def _cancel(self, tasks: Iterable[Task], *, force: bool) -> None:
        with self._noting_errors():
            self._cluster.cancel(tasks, force=force)

    @contextmanager
    def _noting_errors(self) -> Iterator[None]:
        """Note each error of the cluster once and continue: the results so far are kept."""
        try:
            yield
        except EngineError as error:
            if str(error) not in self._problems:
                self._problems.add(str(error))
                self._observer.note(str(error))

    def _start(self, entries: Sequence[_Submitted]) -> None:
        for entry in entries:
            entry.starts += 1
            entry.folder = TaskFolder.make(self.scratch / f"{entry.number}.{entry.starts}", entry.job.order())
            entry.seen, entry.ended_s = TaskProgress(), None
        tasks = self._cluster.start([entry.folder.path for entry in entries])
        self._running.update(zip(tasks, entries, strict=True))

    def _watch(self) -> None:
        """Collect ended tasks until the engine is left; an error here becomes the error of every job."""
        while not self._closed.wait(POLL_S):
            try:
                with self._lock:
                    self._poll()
            except Exception as error:  # noqa: BLE001 it is raised again where the runner asks for the results
                with self._lock:
                    for entry in self._running.values():
                        if not entry.future.done():
                            entry.future.set_exception(error)
                    self._running.clear()

    def _poll(self) -> None:
        ends = self._cluster.ended(list(self._running)) if self._running else {}
        for task, entry in list(self._running.items()):
            try:
                self._report_progress(entry)
                done = task in ends and self._end(entry, ends[task])
            except GridtrackError as error:
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

    def _report_progress(self, entry: _Submitted) -> None:
        """Report the new progress of a task to the observer."""
        seen, now = entry.seen, entry.folder.progress()
        for note in now.notes[len(seen.notes) :]:
            self._observer.note(note)
        if now.frames is not None and seen.frames is None:
            self._observer.started(entry.job.name, now.frames)
        if now.frames is not None:
            for _ in range(now.delivered - seen.delivered):
                self._observer.advanced(entry.job.name)
        entry.seen = now

    def _end(self, entry: _Submitted, end: TaskEnd) -> bool:
        """Handle a task that has ended. Returns False if its reply may still become visible."""
        reply = entry.folder.reply()
        cancelled = self._cancelled_s is not None
        if reply is not None and (cancelled or not _ended_from_outside(reply, end)):
            self._report_progress(entry)
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
        """Whether the reply of a task that ended normally has had time to become visible."""
        entry.ended_s = entry.ended_s or time.monotonic()
        return time.monotonic() >= entry.ended_s + REPLY_S

    def _accept(self, entry: _Submitted, reply: Reply) -> None:
        entry.folder.move_files(reply, self._run_folder / entry.job.name, entry.job.replaces)
        shutil.rmtree(entry.folder.path, ignore_errors=True)
        if reply.outcome:
            entry.future.set_result(entry.job.result())
        elif reply.error == INTERRUPTED:
            _end_as_cancelled(entry.future)
        else:
            entry.future.set_exception(EngineError(reply.error))

    def _retry(self, entry: _Submitted, reason: str) -> None:
        """Start a lost job again, or end it after RETRIES."""
        shutil.rmtree(entry.folder.path, ignore_errors=True)
        if entry.starts > RETRIES:
            error = f"lost by the engine {entry.starts} times, the last time because {reason}: compare with --resume"
            entry.future.set_exception(EngineError(error))
            return
        note = f"lost by the engine ({reason}); starts again, {entry.starts} of {RETRIES}"
        self._observer.note(f"{entry.job.name}: {note}")
        self._start([entry])


def _end_as_cancelled(future: Future[Any]) -> None:
    """End a future without a result. Without the notification, `wait` would never return."""
    if future.cancel():
        future.set_running_or_notify_cancel()


def _ended_from_outside(reply: Reply, end: TaskEnd) -> bool:
    """Whether neither the tracker nor an error ended the job.

    A scheduler that takes a machine away ends trackers too, maybe before the process that would report the difference.
    """
    return INTERRUPTED in {reply.error, reply.outcome} or (end.lost and reply.outcome != "ok")
