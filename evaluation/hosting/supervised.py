"""A program under the supervisor: messages with deadlines, interrupts, and a guaranteed end of all its processes."""

from __future__ import annotations

import contextlib
import json
import math
import os
import select
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from tempfile import mkdtemp
from typing import IO

from gridtrack.common.files import open_new
from gridtrack.evaluation.hosting.host import forget_leader, start_leader
from gridtrack.evaluation.hosting.nursery import SUPERVISOR, ForkedSupervisor, fork_supervisor
from gridtrack.trackers.wire import Message, encode, receive, widen, without

OF_A_SIGNAL = 128
SLICE_S = 1.0
"""Longest single wait. A wait that lasts longer by another SLICE_S shows that this process did not run meanwhile."""
INTERRUPT = b"i"
ORDERLY_END_S = 2.0
KILL_S = 10.0


@dataclass(frozen=True, slots=True)
class ProcessExit:
    """Exit of a supervised program: `status` from `os.waitpid`, None if unknown; `peak_kb` resident memory, KiB."""

    status: int | None = None
    peak_kb: int = 0
    over_memory: bool = False
    start_error: str = ""

    def __str__(self) -> str:
        if self.start_error:
            return f"cannot be started ({self.start_error})"
        if self.status is None:
            return "ended for an unknown reason"
        names = {s.value: s.name for s in signal.Signals}
        if os.WIFSIGNALED(self.status):
            number = os.WTERMSIG(self.status)
            return f"killed by {names.get(number, f'signal {number}')}"
        code = os.WEXITSTATUS(self.status)
        if code - OF_A_SIGNAL in names:  # the exit code by which a shell, and the sandbox, report a signal
            return f"exited with code {code}: killed by {names[code - OF_A_SIGNAL]}"
        return f"exited with code {code}"


class TimeLimit:
    """The time left of a limit: time in which this process did not run, because it was stopped, does not count."""

    def __init__(self, seconds: float = math.inf) -> None:
        self.left_s = seconds
        self._at_s = time.monotonic()

    def spend(self) -> None:
        """Count the time since the last call."""
        now_s = time.monotonic()
        self.left_s -= min(now_s - self._at_s, 2 * SLICE_S)
        self._at_s = now_s

    def wait(self, fd: int, event: int) -> None:
        """Wait until `fd` is ready for `event` of poll. Raises TimeoutError when no time is left."""
        poll, ready = select.poll(), False
        poll.register(fd, event)
        while not ready:
            self.spend()
            if self.left_s <= 0.0:
                raise TimeoutError
            ready = bool(poll.poll(1000 * min(self.left_s, SLICE_S)))


class SupervisedProgram:
    """A program started as a child of a supervisor process, in its own session, so that Ctrl-C does not reach it.

    The supervisor ends the program and all processes that it started, and removes its temporary folder (`TMPDIR`) and
    its files in shared memory, also when this process dies. If the supervisor itself was killed, this process ends the
    processes that it adopted (`adopt_orphans`). `send` and `receive` are for one thread, other methods for any.
    """

    def __init__(
        self,
        argv: tuple[str, ...],
        env: Mapping[str, str],
        *,
        log: Path | None = None,
        memory_mb: int | None = None,
        cwd: Path | None = None,
        inherited: tuple[int, ...] = (),
        from_nursery: bool = False,
    ) -> None:
        """Start the program. Its stderr goes to `log`, in bounded size, or to the stderr of this process.

        With `memory_mb` it ends when the resident memory of all its processes exceeds it. It has the descriptors
        `inherited`, too. A tracker of this Python may come `from_nursery`, with a log and without `cwd`.
        Raises OSError if the log cannot be opened.
        """
        self._folder = mkdtemp(prefix="gridtrack-")
        arguments = [str(memory_mb or 0), "1" if log else "0", self._folder, *argv]
        with open_new(log) if log else contextlib.nullcontext() as stderr:
            supervisor = self._forked(env, arguments, stderr) if from_nursery and stderr else None
            self._supervisor = supervisor or self._started(env, arguments, stderr, cwd, inherited)
        for pipe in (self._stdin, self._stdout):
            os.set_blocking(pipe.fileno(), False)
            widen(pipe.fileno())
        self._exit: ProcessExit | None = None
        self.killed = False
        """Whether `kill` was called."""

    def _started(
        self,
        env: Mapping[str, str],
        arguments: list[str],
        stderr: IO[bytes] | None,
        cwd: Path | None,
        inherited: tuple[int, ...],
    ) -> subprocess.Popen[bytes]:
        """A supervisor as a new program."""
        with self._other_ends() as (stdin, stdout, control):
            return start_leader(
                lambda: subprocess.Popen(
                    [sys.executable, "-I", "-S", str(SUPERVISOR), str(control), *arguments],
                    stdin=stdin,
                    stdout=stdout,
                    stderr=stderr,
                    pass_fds=(control, *inherited),
                    env=env,
                    cwd=cwd,
                    start_new_session=True,
                )
            )

    def _forked(self, env: Mapping[str, str], arguments: list[str], stderr: IO[bytes]) -> ForkedSupervisor | None:
        """A supervisor from the nursery; None if it has ended."""
        with self._other_ends() as (stdin, stdout, control):
            descriptors = (stdin, stdout, stderr.fileno(), control)
            supervisor = fork_supervisor(env, arguments, descriptors, self._control)
        if supervisor is None:
            for own in (self._stdin, self._stdout, self._control):
                own.close()
        return supervisor

    @contextlib.contextmanager
    def _other_ends(self) -> Iterator[tuple[int, int, int]]:
        """The supervisor's ends of the wire and of the control socket; this process keeps its own ends only."""
        (stdin, self._stdin), (self._stdout, stdout) = _pipe(), _pipe()
        self._control, control = socket.socketpair()
        with stdin, stdout, control:
            yield stdin.fileno(), stdout.fileno(), control.fileno()

    def send(self, message: Message, limit: TimeLimit | None = None) -> None:
        """Send `message` within `limit`. Raises TimeoutError, BrokenPipeError."""
        limit = limit or TimeLimit()
        left = encode(message)
        while left:
            try:
                left = without(left, os.writev(self._stdin.fileno(), left))
            except BlockingIOError:
                limit.wait(self._stdin.fileno(), select.POLLOUT)

    def receive(self, max_body: int = 0, limit: TimeLimit | None = None) -> Message:
        """Receive a message with at most `max_body` bytes of arrays within `limit`.

        Raises TimeoutError, EOFError, WireError.
        """
        limit = limit or TimeLimit()
        return receive(lambda buffers: self._fill(buffers, limit), max_body)

    def _fill(self, buffers: list[memoryview], limit: TimeLimit) -> None:
        left = [b for b in buffers if b.nbytes]
        while left:
            try:
                count = os.readv(self._stdout.fileno(), left)
            except BlockingIOError:
                limit.wait(self._stdout.fileno(), select.POLLIN)
                continue
            if count == 0:
                raise EOFError
            left = without(left, count)

    def has_unread(self) -> bool:
        """Whether there are received bytes that have not been read."""
        poll = select.poll()
        poll.register(self._stdout.fileno(), select.POLLIN)
        return any(event & select.POLLIN for _, event in poll.poll(0))

    def interrupt(self) -> None:
        """Interrupt the program itself (SIGINT), and no other process."""
        with contextlib.suppress(OSError):  # it has ended
            self._control.send(INTERRUPT)

    def kill(self) -> None:
        """End the program and everything that it started, without waiting for it."""
        self.killed = True
        # another thread may have closed it already
        with contextlib.suppress(OSError):
            self._control.shutdown(socket.SHUT_WR)

    def ended(self, within_s: float) -> bool:
        """Whether the program ends by itself within `within_s` seconds."""
        poll = select.poll()
        poll.register(self._control.fileno(), select.POLLIN)
        return bool(poll.poll(within_s * 1000))

    def close(self, orderly: bool = True) -> ProcessExit:
        """End the program and its processes; an `orderly` end first gives it ORDERLY_END_S to exit by itself."""
        if self._exit is None:
            self._stdin.close()
            if not orderly or not self.ended(ORDERLY_END_S):
                self.kill()
            self._exit = self._collect_exit()
            self._stdout.close()
            self._control.close()
            shutil.rmtree(self._folder, ignore_errors=True)  # where the supervisor was killed
        return self._exit

    def _collect_exit(self) -> ProcessExit:
        self._control.settimeout(KILL_S)
        try:
            with self._control.makefile("rb") as lines:
                line = lines.readline()
            self._supervisor.wait(KILL_S)
        except (TimeoutError, subprocess.TimeoutExpired):
            line = b""
        if self._supervisor.poll() is None:  # only a stopped or blocked supervisor is still alive here
            self._supervisor.kill()
            self._supervisor.wait()
        forget_leader(self._supervisor, orderly=bool(line))
        return ProcessExit(**json.loads(line)) if line else ProcessExit()


def _pipe() -> tuple[FileIO, FileIO]:
    """The reading and the writing end of a new pipe."""
    reading, writing = os.pipe()
    return FileIO(reading, "rb"), FileIO(writing, "wb")
