"""Processes that a tracker leaves behind when it kills its own supervisor: a host that adopts them ends them."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from subprocess import Popen
from typing import Any

from gridtrack.evaluation.hosting.supervisor import (
    GIVE_UP_S,
    PR_SET_CHILD_SUBREAPER,
    children,
    descendants,
    kill,
    prctl,
)

_lock = threading.Lock()
_leaders: set[int] = set()
"""Children of this process that lead a session of their own."""


def adopt_orphans() -> None:
    """Make this process the parent of what its descendants leave behind: for a program that is gridtrack alone."""
    prctl(PR_SET_CHILD_SUBREAPER, 1)


def start_leader(start: Callable[[], Popen[Any]]) -> Popen[Any]:
    """The child that `start` starts in a session of its own, which is no orphan."""
    with _lock:
        leader = start()
        _leaders.add(leader.pid)
    return leader


def forget_leader(leader: Popen[Any], orderly: bool) -> None:
    """A leader has ended; if not `orderly`, end the processes that it left behind and that this process adopted.

    Adopted is a child of a session that is neither that of this process nor of one of its leaders.
    """
    with _lock:
        _leaders.discard(leader.pid)
        give_up = time.monotonic() + GIVE_UP_S
        while not orderly and (adopted := _adopted()) and time.monotonic() < give_up:
            for pid in adopted:
                _end(pid)
            time.sleep(0.002)


def _adopted() -> list[int]:
    known = {os.getsid(0), *_leaders}
    return [pid for pid in children(os.getpid()) if _session(pid) not in known]


def _session(pid: int) -> int:
    """The session of a child; its own where it has ended in the meantime."""
    with suppress(ProcessLookupError):
        return os.getsid(pid)
    return pid


def _end(pid: int) -> None:
    """Kill a child and all its descendants, and collect it."""
    for one in (*descendants(pid), pid):
        kill(one)
    with suppress(ChildProcessError):
        os.waitpid(pid, os.WNOHANG)
