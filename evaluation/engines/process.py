"""A process of a cluster while it carries out one attempt: the work in a thread, progress and interrupts beside it."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from pathlib import Path

from gridtrack.common.errors import GridtrackError
from gridtrack.evaluation.engines.attempt import INTERRUPTED, Attempt, AttemptProgress, Reply
from gridtrack.evaluation.engines.engine import WAKE_S, Interrupted, Work
from gridtrack.evaluation.hosting.supervisor import make_unreadable
from gridtrack.evaluation.results.trial_record import TrialRecord

PROGRESS_S = 1.0
"""Time between two writings of the progress."""

WorkOf = Callable[[Attempt, Callable[[str], None]], Work]
"""Gives the work that an attempt's order describes; the second argument takes a line for the user."""


def serve_attempt(folder: Path, work_of: WorkOf, reason_of: Callable[[Exception], str]) -> bool:
    """Carry out the attempt in `folder`, and reply; KeyboardInterrupt ends it with the record so far.

    For the main thread of a process, which then receives interrupts. `reason_of` gives an unexpected error as one line.
    An attempt that the host gave up ends without a reply. Returns whether nothing interrupted it.
    """
    make_unreadable()
    # a process that was started in the background ignores interrupts
    signal.signal(signal.SIGINT, signal.default_int_handler)
    attempt = Attempt(folder)
    monitor = AttemptMonitor()
    try:
        reply = Reply(record=_carried_out(attempt, work_of, monitor))
    except (Interrupted, KeyboardInterrupt):
        monitor.stop()
        reply = Reply(error=INTERRUPTED)
    except GridtrackError as error:
        reply = Reply(error=str(error))
    except Exception as error:  # noqa: BLE001 the host tells the user
        reply = Reply(error=reason_of(error))
    if attempt.folder.is_dir():
        attempt.write_progress(monitor.progress())
        attempt.write_reply(reply)
    return not monitor.stopped()


def _carried_out(attempt: Attempt, work_of: WorkOf, monitor: AttemptMonitor) -> TrialRecord:
    work = work_of(attempt, monitor.note)
    with ThreadPoolExecutor(1, "trial") as thread:
        future = thread.submit(work.run, monitor)
        try:
            _report_until_ended(future, attempt, monitor)
        except BaseException:
            monitor.stop()
            work.interrupt()
            wait([future])
            if future.exception() is not None:
                raise
        return future.result()


def _report_until_ended(future: Future[TrialRecord], attempt: Attempt, monitor: AttemptMonitor) -> None:
    """Write the progress until the work has ended. Raises FileNotFoundError where the attempt was given up."""
    written: AttemptProgress | None = None
    while True:
        for _ in range(round(PROGRESS_S / WAKE_S)):
            if wait([future], WAKE_S).done:
                return
        if (progress := monitor.progress()) != written:
            attempt.write_progress(progress)
            written = progress
        elif not attempt.folder.is_dir():
            raise Interrupted


class AttemptMonitor:
    """The Monitor of a work in a process of a cluster: it counts, and others write the count."""

    def __init__(self) -> None:
        self._frames: int | None = None
        self._delivered = 0
        self._notes: tuple[str, ...] = ()
        self._stop = threading.Event()

    def note(self, text: str) -> None:
        """A message for the user, one line."""
        self._notes = (*self._notes, text)

    def started(self, frames: int) -> None:
        """The work starts; it will deliver `frames` frames."""
        self._frames = frames

    def next_frame(self) -> None:
        """The next frame is delivered. Raises Interrupted."""
        self.check()
        self._delivered += 1

    def check(self) -> None:
        """Raises Interrupted where the run is interrupted."""
        if self._stop.is_set():
            raise Interrupted

    def stop(self) -> None:
        """Interrupt the work at its next frame."""
        self._stop.set()

    def stopped(self) -> bool:
        """Whether the work was interrupted."""
        return self._stop.is_set()

    def progress(self) -> AttemptProgress:
        """How far the work is."""
        return AttemptProgress(frames=self._frames, delivered=self._delivered, notes=self._notes)
