"""The command's side of a training process: what it receives, its lines of progress, and its end."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, NoReturn

from gridtrack.common import errors
from gridtrack.common.errors import GridtrackError, PluginError
from gridtrack.evaluation.hosting.orphans import forget_leader, start_leader
from gridtrack.evaluation.hosting.shielding import shielded_environment
from gridtrack.evaluation.hosting.supervised import ProcessExit
from gridtrack.trackers.contract import FitOutput
from gridtrack.trackers.wire import Message, WireError, encode, fill_from, receive, write_to

INTERRUPT_S = 30.0
"""Time for `fit` to end after Ctrl-C, in which it may save its state."""


class TrainingProcess:
    """A context manager: entering starts a process for the `fit` of the tracker `name`, leaving ends all its processes.

    The process runs in a session of its own, so that Ctrl-C reaches it once, through this process.
    """

    def __init__(self, name: str, recordings: Iterable[Path]) -> None:
        """The environment of the process contains no path of the `recordings`."""
        self.name = name
        self._environment = shielded_environment(recordings)
        self._process: subprocess.Popen[bytes]

    def __enter__(self) -> TrainingProcess:
        command = [sys.executable, "-P", "-m", "gridtrack.evaluation.runs.fit_process", self.name]
        self._process = start_leader(
            lambda: subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                bufsize=0,
                start_new_session=True,
                env=self._environment,
            )
        )
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end()
        self._process.communicate()
        forget_leader(self._process, orderly=True)

    def load(self, options: Mapping[str, Any], *, general: bool) -> bool:
        """Load the tracker with these options, to learn for any place if `general`.

        Whether its training starts from general weights where there are some. Raises PluginError, ConfigurationError.
        """
        self._send("load", options=dict(options), general=general)
        return self._answer("loaded", lambda text: None).value("starts_from_general", bool)

    def fit(
        self,
        train: Sequence[Path],
        validation: Sequence[Path],
        output: FitOutput,
        regions_of: Callable[[int], Path],
    ) -> None:
        """Run `fit` on these files of stretches; its lines go to `output.report`.

        `regions_of(n)` makes the file with the regions of the n-th stretch, those of training first, when `fit` asks
        for it. Raises GridtrackError.
        """
        self._send(
            "fit",
            train=[str(path) for path in train],
            validation=[str(path) for path in validation],
            path=str(output.path),
            command=output.command,
            seed=output.seed,
            log_dir=str(output.log_dir),
            general=output.general,
            start=str(output.start or ""),
        )
        with self._passing_on_interrupts() as interrupted:
            try:
                self._answer("done", output.report, lambda n: self._send("regions", path=str(regions_of(n))))
            except GridtrackError:
                if not interrupted.is_set():
                    raise
        if interrupted.is_set():
            raise KeyboardInterrupt

    @contextlib.contextmanager
    def _passing_on_interrupts(self) -> Iterator[threading.Event]:
        """Inside it Ctrl-C interrupts `fit`, which has INTERRUPT_S to save its state; a second one ends it.

        No exception is raised here: it could come in the middle of a message, and the last lines would be lost.
        """
        interrupted, too_late = threading.Event(), threading.Timer(INTERRUPT_S, self._end)

        def pass_on(*_: object) -> None:
            if interrupted.is_set():
                self._end()
                return
            interrupted.set()
            self._process.send_signal(signal.SIGINT)
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

    def _end(self) -> None:
        """Kill the process and all that it started in its session."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)

    def _send(self, kind: str, **fields: Any) -> None:
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # the missing answer says why it ended
            write_to(self._process.stdin.fileno(), encode(Message(kind, 0, fields)))

    def _answer(
        self, expected: str, report: Callable[[str], None], send_regions: Callable[[int], None] | None = None
    ) -> Message:
        """Wait for the answer `expected`; before it lines of progress go to `report`, requests to `send_regions`."""
        assert self._process.stdout is not None
        fill = fill_from(self._process.stdout.fileno())
        while True:
            try:
                answer = receive(fill, 0)
            except EOFError:
                raise self._failed(str(ProcessExit(_status(self._process.wait())))) from None
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


def _status(code: int) -> int:
    """The exit code of a Popen as the status of `os.waitpid`."""
    return -code if code < 0 else code << 8
