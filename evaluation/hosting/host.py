"""This process as the host of others: it hides recordings from them in /proc, and ends the processes that they leave.

docs/wire.md, "Isolation", lists the traces that a tracker's process can still see.
"""

from __future__ import annotations

import ctypes
import os
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Protocol, TypeVar

from gridtrack.evaluation.hosting.supervisor import (
    GIVE_UP_S,
    PR_SET_CHILD_SUBREAPER,
    PR_SET_DUMPABLE,
    make_unreadable,
    prctl,
    show_arguments,
    shown_arguments,
)

PR_GET_DUMPABLE = 3

_lock = threading.Lock()
_adopting = threading.Event()
_leaders: set[int] = set()
"""Processes that lead a session of their own, and are no orphans."""
StartedLeader = TypeVar("StartedLeader", bound="Leader")


@contextmanager
def shielded_host(title: str, *, alone: bool) -> Iterator[None]:
    """In the block this process has `title` as its command line, and its /proc entries are unreadable for others.

    A program that is gridtrack `alone` also becomes the parent of orphans of its trackers. On systems other than
    Linux nothing changes.
    """
    if sys.platform != "linux":
        yield
        return
    start, size = shown_arguments()
    before, readable = ctypes.string_at(start, size), ctypes.CDLL(None).prctl(PR_GET_DUMPABLE, 0, 0, 0, 0)
    show_arguments(title.encode())
    make_unreadable()
    adopt_orphans(alone)
    try:
        yield
    finally:
        adopt_orphans(False)
        prctl(PR_SET_DUMPABLE, readable)
        ctypes.memmove(start, before, size)


def shielded_environment(recordings: Iterable[Path]) -> dict[str, str]:
    """The environment of this process without the variables that contain the path or the file name of a recording."""
    hidden = {text for path in recordings for text in (str(path.absolute()), str(path.resolve()), _file_name(path))}
    hidden.discard("")
    return {name: value for name, value in os.environ.items() if not any(text in value for text in hidden)}


def adopt_orphans(adopt: bool = True) -> None:
    """Become the parent of descendants after the end of their parents: for a program that is gridtrack alone.

    In another program, such as a notebook, a child in a session of its own may be the user's, and is left alone.
    """
    prctl(PR_SET_CHILD_SUBREAPER, int(adopt))
    (_adopting.set if adopt else _adopting.clear)()


class Leader(Protocol):
    """A process in a session of its own, which is no orphan."""

    pid: int


def start_leader(start: Callable[[], StartedLeader]) -> StartedLeader:
    """The leader that `start` starts."""
    with _lock:
        leader = start()
        _leaders.add(leader.pid)
    return leader


def forget_leader(leader: Leader, orderly: bool) -> None:
    """A leader has ended; if not `orderly`, end its processes that this process adopted.

    A child is adopted if its session is neither this process's nor a leader's.
    """
    with _lock:
        _leaders.discard(leader.pid)
        give_up = time.monotonic() + GIVE_UP_S
        while not orderly and _adopting.is_set() and (adopted := _adopted()) and time.monotonic() < give_up:
            for process in adopted:
                _end(process)
            time.sleep(0.002)


def _adopted() -> list[Any]:
    """The adopted processes, as psutil.Process."""
    import psutil

    known = {os.getsid(0), *_leaders}
    return [child for child in psutil.Process().children() if _session(child.pid) not in known]


def _session(pid: int) -> int:
    """The session of a child; its own id if it has ended in the meantime."""
    with suppress(ProcessLookupError):
        return os.getsid(pid)
    return pid


def _end(process: Any) -> None:
    """Kill a child and all its descendants, and collect it."""
    import psutil

    with suppress(psutil.NoSuchProcess):
        for one in (*process.children(recursive=True), process):
            with suppress(psutil.NoSuchProcess):
                one.kill()
    with suppress(ChildProcessError):
        os.waitpid(process.pid, os.WNOHANG)


def _file_name(path: Path) -> str:
    """The name of a file with a suffix; "" for a name without one, which may be an ordinary word."""
    return path.name if path.suffix else ""
