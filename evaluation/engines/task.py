"""A task of a cluster: one execution of a job by a process on some machine.

Host and process share the folder of the task and nothing else. The process writes into it only; the host moves the
files to the trial's folder when it accepts the reply, so an abandoned task changes no result. All of it is JSON:
nothing that comes back is unpickled.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from gridtrack.common.config import Settings
from gridtrack.common.errors import GridtrackError
from gridtrack.common.files import read_bounded, write_text
from gridtrack.evaluation.engines.engine import WAKE_S, EngineError, Interrupted, Job, JobResult, Monitor
from gridtrack.evaluation.hosting.supervisor import make_unreadable

MAX_ORDER_BYTES = MAX_REPLY_BYTES = 1 << 24
MAX_PROGRESS_BYTES = 1 << 20
INTERRUPTED = "interrupted"
"""An outcome, and the error of a reply without a result."""
PROGRESS_S = 1.0
"""Time between two updates of the progress file."""
Exchanged = TypeVar("Exchanged", bound=BaseModel)


class TaskProgress(Settings):
    """The progress of a task."""

    frames: int | None = None
    """Number of frames that it will deliver; None before it starts, or if it counts none."""
    delivered: int = 0
    notes: tuple[str, ...] = ()
    """Messages for the user, one line each."""


class Reply(Settings):
    """The end of a task: the outcome of the job's result, and its files; or an error in one line."""

    outcome: str = ""
    files: tuple[str, ...] = ()
    """Names of its files, the result's last."""
    error: str = ""


@dataclass(frozen=True, slots=True)
class TaskFolder:
    """The folder of a task: the job's order, the progress, the job's files, and the reply."""

    path: Path

    @property
    def files(self) -> Path:
        """The folder for the files of the trial."""
        return self.path / "files"

    @classmethod
    def make(cls, path: Path, order: str) -> TaskFolder:
        """Make the folder, with the JSON `order` of the job. Raises OSError."""
        folder = cls(path)
        folder.files.mkdir(parents=True)
        write_text(path / "order.json", order)
        return folder

    def order(self) -> str:
        """The JSON description of the job. Raises EngineError, FileNotFoundError."""
        return read_bounded(self.path / "order.json", MAX_ORDER_BYTES, EngineError).decode()

    def progress(self) -> TaskProgress:
        """The progress so far. Raises EngineError."""
        return self._read("progress.json", TaskProgress, MAX_PROGRESS_BYTES) or TaskProgress()

    def has_reply(self) -> bool:
        """Whether there is a reply."""
        return (self.path / "reply.json").exists()

    def reply(self) -> Reply | None:
        """The reply; None before there is one. Raises EngineError."""
        return self._read("reply.json", Reply, MAX_REPLY_BYTES)

    def write_progress(self, progress: TaskProgress) -> None:
        """Write the progress. Raises FileNotFoundError if the host has abandoned the task."""
        write_text(self.path / "progress.json", progress.model_dump_json())

    def write_reply(self, reply: Reply) -> None:
        """Write the reply, after all other files. Raises FileNotFoundError if the host has abandoned the task."""
        write_text(self.path / "reply.json", reply.model_dump_json())

    def move_files(self, reply: Reply, folder: Path, replaced: tuple[str, ...]) -> None:
        """Move the files of `reply` to the trial's `folder`, and remove the `replaced` ones there. Raises OSError."""
        folder.mkdir(parents=True, exist_ok=True)
        for name in replaced:
            (folder / name).unlink(missing_ok=True)
        for name in reply.files:
            (self.files / Path(name).name).replace(folder / Path(name).name)

    def _read(self, name: str, model: type[Exchanged], max_bytes: int) -> Exchanged | None:
        path = self.path / name
        try:
            return model.model_validate_json(read_bounded(path, max_bytes, EngineError))
        except FileNotFoundError:
            return None
        except ValidationError as error:
            raise EngineError(f"{path}: not as an engine writes it ({error.error_count()} errors)") from None


JobOf = Callable[[TaskFolder, Callable[[str], None]], Job[Any]]
"""Makes the job that a task's order describes; the second argument receives lines for the user."""


def run_task(path: Path, job_of: JobOf, reason_of: Callable[[Exception], str]) -> bool:
    """Execute the task in the folder `path`, and reply; KeyboardInterrupt ends it with the result so far.

    For the main thread of a process, which then receives interrupts. `reason_of` gives an unexpected error as one line.
    An abandoned task ends without a reply. Returns whether nothing interrupted it.
    """
    make_unreadable()
    # a process that was started in the background ignores interrupts
    signal.signal(signal.SIGINT, signal.default_int_handler)
    folder, counted, stop = TaskFolder(path), _Counted(), threading.Event()
    try:
        reply = _executed(folder, job_of, counted, stop)
    except (Interrupted, KeyboardInterrupt):
        stop.set()
        reply = Reply(error=INTERRUPTED)
    except GridtrackError as error:
        reply = Reply(error=str(error))
    except Exception as error:  # noqa: BLE001 the host reports it to the user
        reply = Reply(error=reason_of(error))
    if path.is_dir():
        folder.write_progress(counted.progress)
        folder.write_reply(reply)
    return not stop.is_set()


def _executed(folder: TaskFolder, job_of: JobOf, counted: _Counted, stop: threading.Event) -> Reply:
    """Run the job in a thread; its progress and interrupts are handled beside it."""
    job = job_of(folder, counted.note)
    with ThreadPoolExecutor(1, "trial") as thread:
        future: Future[JobResult] = thread.submit(job.run, Monitor(job.name, counted, stop))
        try:
            _write_progress(future, folder, counted)
        except BaseException:
            stop.set()
            job.interrupt()
            wait([future])
            if future.exception() is not None:
                raise
        names = sorted((path.name for path in folder.files.iterdir()), key=lambda name: (name == job.result_file, name))
        return Reply(outcome=future.result().outcome, files=tuple(names))


def _write_progress(future: Future[JobResult], folder: TaskFolder, counted: _Counted) -> None:
    """Write the progress until the job has ended. Raises FileNotFoundError if the task was abandoned."""
    written: TaskProgress | None = None
    while True:
        for _ in range(round(PROGRESS_S / WAKE_S)):
            if wait([future], WAKE_S).done:
                return
        if (progress := counted.progress) != written:
            folder.write_progress(progress)
            written = progress
        elif not folder.path.is_dir():
            raise Interrupted


class _Counted:
    """A JobObserver of one job in a process of a cluster; its `progress` is written by another thread."""

    def __init__(self) -> None:
        self.progress = TaskProgress()

    def note(self, text: str) -> None:
        """A message for the user, one line."""
        self._add(notes=(*self.progress.notes, text))

    def started(self, job: str, frames: int) -> None:
        """The job starts; it will deliver `frames` frames."""
        self._add(frames=frames)

    def advanced(self, job: str) -> None:
        """The next frame is delivered."""
        self._add(delivered=self.progress.delivered + 1)

    def _add(self, **known: Any) -> None:
        self.progress = self.progress.model_copy(update=known)
