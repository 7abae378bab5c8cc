"""The nursery of trackers in Python: a process that has loaded their common libraries, and forks each of them.

Loading these takes 0.4 s of a processor for each tracker, a fork some thousandths. The nursery has loaded nothing of a
tracker and learns nothing of it: it is as new for the last tracker as for the first one.
"""

from __future__ import annotations

import atexit
import json
import os
import select
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from gridtrack.evaluation.hosting.host import forget_leader, start_leader
from gridtrack.evaluation.hosting.supervisor import FORK, LENGTH_BYTES

SUPERVISOR = Path(__file__).with_name("supervisor.py")
OF_LOADING = (
    *("PYTHON", "LD_", "HOME", "LANG", "LC_", "MALLOC_"),
    *("OMP_", "MKL_", "OPENBLAS_", "GOTO_", "NPY_", "NUMEXPR_", "VECLIB_"),
)
"""Beginnings of the environment variables that Python and its libraries read while they are loaded."""
NURSERY_ANSWER_S = 60.0
"""A nursery that does not answer for as long, because somebody stopped it, is ended."""


class ForkedSupervisor:
    """A supervisor that is no child of this process: as much of `subprocess.Popen` as SupervisedProgram needs."""

    def __init__(self, pid: int, descriptor: int) -> None:
        """`descriptor`: of the process `pid` (pidfd)."""
        self.pid = pid
        self._descriptor: int | None = descriptor

    def poll(self) -> int | None:
        """None while it runs."""
        with suppress(subprocess.TimeoutExpired):
            self.wait(0.0)
        return None if self._descriptor is not None else 0

    def wait(self, timeout: float | None = None) -> None:
        """Wait for its end. Raises subprocess.TimeoutExpired."""
        if self._descriptor is None:
            return
        poll = select.poll()
        poll.register(self._descriptor, select.POLLIN)
        if not poll.poll(None if timeout is None else 1000 * timeout):
            raise subprocess.TimeoutExpired("supervisor", timeout or 0.0)
        with suppress(ChildProcessError):  # the nursery is its parent, unless it was killed
            os.waitid(os.P_PIDFD, self._descriptor, os.WEXITED | os.WNOHANG)
        os.close(self._descriptor)
        self._descriptor = None

    def kill(self) -> None:
        """Kill it."""
        if self._descriptor is not None:
            signal.pidfd_send_signal(self._descriptor, signal.SIGKILL)


class Nursery:
    """The process, with the variables `env` alone; it ends with this one, and after a minute without a request.

    What a program can read of its own first environment, in /proc, is that of the nursery.
    """

    def __init__(self, env: Mapping[str, str]) -> None:
        self._requests, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._requests.settimeout(NURSERY_ANSWER_S)
        with theirs:
            self._process = start_leader(
                lambda: subprocess.Popen(
                    [sys.executable, "-P", str(SUPERVISOR), str(theirs.fileno())],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                    pass_fds=(theirs.fileno(),),
                    env=env,
                    start_new_session=True,
                )
            )

    def fork(self, descriptors: Sequence[int]) -> ForkedSupervisor:
        """A supervisor with these descriptors of its own. Raises OSError or ValueError without an answer."""
        socket.send_fds(self._requests, [FORK], descriptors)
        answer, (descriptor, *_), *_ = socket.recv_fds(self._requests, 32, 1)
        return ForkedSupervisor(int(answer), descriptor)

    def close(self) -> None:
        """End it."""
        self._requests.close()
        self._process.kill()
        self._process.wait()
        forget_leader(self._process, orderly=True)


_lock = threading.Lock()
_kept: dict[tuple[object, ...], Nursery] = {}
"""The last nursery, by the number of this process and by its environment."""


def fork_supervisor(
    env: Mapping[str, str], arguments: Sequence[str], descriptors: Sequence[int], control: socket.socket
) -> ForkedSupervisor | None:
    """A supervisor of a tracker with the environment `env`; `arguments` and `descriptors` as in supervisor.py.

    It reads the rest on the socket to `control`. None if the nursery has ended, because nobody needed it or somebody
    killed it: the next one starts anew. None on systems other than Linux.
    """
    if sys.platform != "linux":
        return None
    with _lock:
        try:
            started = json.dumps({"cwd": str(Path.cwd()), "env": dict(env), "arguments": arguments}).encode()
            nursery = _nursery(_read_in_loading(env))
            supervisor = start_leader(lambda: nursery.fork(descriptors))
        except (OSError, ValueError):
            end_nursery()
            return None
        except KeyboardInterrupt:
            end_nursery()  # else the next one would read its answer
            raise
    with suppress(OSError):  # it was killed, as the reader of its report will see
        control.sendall(len(started).to_bytes(LENGTH_BYTES, "little") + started)
    return supervisor


def _read_in_loading(env: Mapping[str, str]) -> dict[str, str]:
    """The variables that matter while Python and its libraries are loaded, with absolute paths."""
    found = {name: value for name, value in env.items() if name.startswith(OF_LOADING)}
    if "PYTHONPATH" in found:
        found["PYTHONPATH"] = os.pathsep.join(str(Path(p).absolute()) for p in found["PYTHONPATH"].split(os.pathsep))
    return found


def _nursery(env: Mapping[str, str]) -> Nursery:
    key = (os.getpid(), *sorted(env.items()))
    if key not in _kept:
        end_nursery()
        _kept[key] = Nursery(env)
    return _kept[key]


@atexit.register
def end_nursery() -> None:
    """End the nursery of this process."""
    while _kept:
        (pid, *_), nursery = _kept.popitem()
        if pid == os.getpid():
            nursery.close()
