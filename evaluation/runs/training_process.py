"""A training in a process of its own: the command's side, which sends stretches and receives lines of progress.

The process (`fit_process.py`) speaks messages of the wire with the command `train`. `load` is answered by `loaded`, and
`fit` by any number of `report` and `regions`, then `done`; a failure of either by `error`. It receives files of frames,
a copy of the general weights to start from, and no recording; and for each `regions` the file with the regions of one
stretch, which is made then.
"""

from __future__ import annotations

import contextlib
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, NoReturn, Self

from gridtrack.common import errors
from gridtrack.common.errors import GridtrackError, PluginError
from gridtrack.evaluation.hosting.host import shielded_environment
from gridtrack.evaluation.hosting.supervised import SupervisedProgram
from gridtrack.trackers.training.progress import Progress
from gridtrack.trackers.wire import Message, WireError

INTERRUPT_S = 30.0
"""Time for `fit` to end after Ctrl-C, in which it may save its state."""
LINE_EVERY_S = 9.0
"""A line is promised every ten seconds; the processor may be busy."""


class TrainingProcess:
    """A context manager: entering starts a process for the `fit` of the tracker `name`, leaving ends all its processes.

    Ctrl-C reaches the process once, through this one.
    """

    def __init__(self, name: str, recordings: Iterable[Path]) -> None:
        """The environment of the process contains no path of the `recordings`."""
        self.name = name
        self._environment = shielded_environment(recordings)
        self._program: SupervisedProgram

    def __enter__(self) -> Self:
        command = (sys.executable, "-P", "-m", "gridtrack.evaluation.runs.fit_process", self.name)
        self._program = SupervisedProgram(command, self._environment)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._program.close(orderly=False)

    def load(self, options: Mapping[str, Any], *, general: bool) -> bool:
        """Load the tracker with these options, to learn for any place if `general`.

        Returns whether its training can start from general weights. Raises PluginError, ConfigurationError.
        """
        self._send("load", options=dict(options), general=general)
        return self._answer("loaded", lambda text: None).value("starts_from_general", bool)

    def fit(
        self,
        train: Sequence[Path],
        validation: Sequence[Path],
        regions_of: Callable[[int], Path],
        report: Callable[[str], None],
        *,
        out: Path,
        log_dir: Path,
        seed: int,
        command: str,
        general: bool,
        start: Path | None,
    ) -> None:
        """Run `fit` on these files of stretches, with the other fields of its FitTask; its lines go to `report`.

        `regions_of(n)` makes the file with the regions of the n-th stretch, training before validation, when `fit`
        requests it. Raises GridtrackError, KeyboardInterrupt.
        """
        self._send(
            "fit",
            train=[str(path) for path in train],
            validation=[str(path) for path in validation],
            out=str(out),
            log_dir=str(log_dir),
            seed=seed,
            command=command,
            general=general,
            start=str(start or ""),
        )
        with self._passing_on_interrupts() as interrupted:
            try:
                self._answer("done", report, lambda n: self._send("regions", path=str(regions_of(n))))
            except GridtrackError:
                if not interrupted.is_set():
                    raise
        if interrupted.is_set():
            raise KeyboardInterrupt

    @contextlib.contextmanager
    def _passing_on_interrupts(self) -> Iterator[threading.Event]:
        """Inside it Ctrl-C interrupts `fit`, which has INTERRUPT_S to save its state; a second Ctrl-C ends it.

        It raises no exception: one in the middle of a message would lose the last lines.
        """
        interrupted, too_late = threading.Event(), threading.Timer(INTERRUPT_S, self._program.kill)

        def pass_on(*_: object) -> None:
            if interrupted.is_set():
                self._program.kill()
                return
            interrupted.set()
            self._program.interrupt()
            too_late.start()

        if threading.current_thread() is not threading.main_thread():
            yield interrupted
            return
        before = signal.signal(signal.SIGINT, pass_on)
        try:
            yield interrupted
        finally:
            signal.signal(signal.SIGINT, before)
            too_late.cancel()

    def _send(self, kind: str, **fields: Any) -> None:
        with contextlib.suppress(BrokenPipeError):  # the missing answer gives the reason
            self._program.send(Message(kind, 0, fields))

    def _answer(
        self, expected: str, report: Callable[[str], None], send_regions: Callable[[int], None] | None = None
    ) -> Message:
        """Wait for the answer `expected`; lines before it go to `report`, requests for regions to `send_regions`."""
        while True:
            try:
                answer = self._program.receive()
            except EOFError:
                raise self._failed(str(self._program.close())) from None
            if answer.kind == "report":
                report(answer.value("text", str))
            elif answer.kind == "regions" and send_regions is not None:
                send_regions(answer.value("number", int))
            elif answer.kind == "error":
                self._raise(answer)
            elif answer.kind == expected:
                return answer
            else:
                raise WireError(f"training of '{self.name}': '{answer.kind:.40}'; expected '{expected}'")

    def _raise(self, answer: Message) -> NoReturn:
        """Raise the error that the process reports, with its traceback as a note."""
        name, reason = answer.value("error", str), answer.value("reason", str)
        if not name:
            error = self._failed(f"{reason}; --debug shows where")
            error.add_note(answer.value("trace", str))
            raise error
        known = getattr(errors, name, GridtrackError)
        raise known(reason)

    def _failed(self, reason: str) -> PluginError:
        return PluginError(f"tracker '{self.name}': its training failed: {reason}")


class ProgressLines:
    """A context manager: inside it `progress` is reported after `every_s` seconds without another line."""

    def __init__(self, send: Callable[[str], None], every_s: float = LINE_EVERY_S) -> None:
        """`send` is called from two threads."""
        self.progress = Progress()
        self._send, self._every_s = send, every_s
        self._last_s = time.monotonic()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="progress", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        self._thread.join()

    def report(self, text: object) -> None:
        """Send a line of the tracker."""
        self._last_s = time.monotonic()
        self._send(str(text))

    def _run(self) -> None:
        while not self._ended.wait(max(0.0, self._last_s + self._every_s - time.monotonic())):
            if time.monotonic() - self._last_s >= self._every_s:
                self.report(self.progress.text())
