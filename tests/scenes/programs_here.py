"""Trackers and trainings in this process: programs of a SupervisedProgram run here, on the same messages.

For claims that are not about processes. Plugins that the tests have written are imported anew for each program, as in a
fresh process. Other programs, as in a `trackers.toml`, are started as always.
"""

from __future__ import annotations

import importlib
import os
import sys
import tempfile
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any, Protocol

import pytest

from gridtrack.evaluation.hosting.supervised import ProcessExit, SupervisedProgram, TimeLimit
from gridtrack.evaluation.runs import fit_process
from gridtrack.trackers.serve import Server
from gridtrack.trackers.wire import Message, encode, fill_from, receive, write_to

WRITTEN_BY_TESTS = str(Path(tempfile.gettempdir()).resolve())
PEAK_KB = 50_000
SIGKILL = 9
_importing = threading.Lock()


@contextmanager
def programs_here() -> Iterator[None]:
    """In the block, trackers and trainings run in this process."""
    with pytest.MonkeyPatch.context() as patched:
        for module in ("hosting.tracker_process", "runs.training_process"):
            patched.setattr(f"gridtrack.evaluation.{module}.SupervisedProgram", program_here)
        yield


def program_here(argv: tuple[str, ...], env: Mapping[str, str], **how: Any) -> Any:
    """In place of SupervisedProgram: a tracker or a training that runs here, or another program."""
    module = argv[-2] if len(argv) > 1 else ""
    if module == "gridtrack.trackers.serve":
        return ProgramHere(Server(argv[-1]), how["log"])
    if module == "gridtrack.evaluation.runs.fit_process":
        return TrainingHere(argv[-1])
    return SupervisedProgram(argv, env, **how)


class Answering(Protocol):
    """Answers requests of up to `max_body` bytes of arrays."""

    max_body: int

    def answer(self, request: Message) -> list[memoryview]:
        """The encoded answer."""


class ProgramHere:
    """A program on the wire that answers in this process."""

    def __init__(self, server: Answering, log: Path) -> None:
        log.write_bytes(b"")
        self._server = server
        self._answer = b""
        self.killed = False

    def send(self, message: Message, limit: TimeLimit) -> None:
        if self.killed:
            raise BrokenPipeError
        request = received(b"".join(encode(message)), self._server.max_body)
        with importing() if request.kind in {"describe", "start"} else nullcontext():
            self._answer = b"".join(self._server.answer(request))

    def receive(self, max_body: int, limit: TimeLimit) -> Message:
        if self.killed:
            raise EOFError
        limit.spend()
        if limit.left_s <= 0.0:
            raise TimeoutError
        return received(self._answer, max_body)

    def has_unread(self) -> bool:
        return False

    def ended(self, within_s: float) -> bool:
        return self.killed

    def kill(self) -> None:
        self.killed = True

    def close(self, orderly: bool = True) -> ProcessExit:
        return ProcessExit(SIGKILL if self.killed else 0, PEAK_KB)


class TrainingHere:
    """A training that runs in a thread of this process. It cannot be interrupted."""

    def __init__(self, name: str) -> None:
        with importing():
            pass
        read_fd, self._write_fd = os.pipe()
        self._read_fd, write_fd = os.pipe()

        def run() -> None:
            fit_process.run_fit(name, read_fd, write_fd)
            os.close(read_fd)
            os.close(write_fd)

        self._thread = threading.Thread(target=run)
        self._thread.start()

    def send(self, message: Message, limit: TimeLimit | None = None) -> None:
        write_to(self._write_fd, encode(message))

    def receive(self, max_body: int = 0, limit: TimeLimit | None = None) -> Message:
        return receive(fill_from(self._read_fd), max_body)

    def kill(self) -> None:
        raise AssertionError("a training in this process cannot be ended: the test needs a process")

    interrupt = kill

    def close(self, orderly: bool = True) -> ProcessExit:
        os.close(self._write_fd)
        self._thread.join()
        os.close(self._read_fd)
        return ProcessExit(0, PEAK_KB)


def received(content: bytes, max_body: int = 1 << 20) -> Message:
    """The message that the other end of the wire receives, from all of the content."""
    left = memoryview(content)

    def fill(buffers: list[memoryview]) -> None:
        nonlocal left
        for buffer in buffers:
            if buffer.nbytes > left.nbytes:
                raise EOFError
            buffer[:], left = left[: buffer.nbytes], left[buffer.nbytes :]

    message = receive(fill, max_body)
    assert not left.nbytes
    return message


@contextmanager
def importing() -> Iterator[None]:
    """One thread at a time; modules that tests have written are imported anew in the block."""
    with _importing:
        importlib.invalidate_caches()
        for name, module in list(sys.modules.items()):
            if str(getattr(module, "__file__", None) or "").startswith(WRITTEN_BY_TESTS):
                del sys.modules[name]
        yield
