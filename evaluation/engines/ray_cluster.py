"""A Ray cluster: each task is a Ray task, which receives the path of its folder and nothing else."""

from __future__ import annotations

import os
import signal
import socket
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gridtrack.common.errors import ConfigurationError, one_line
from gridtrack.evaluation.engines.remote import TaskEnd

if TYPE_CHECKING:
    from ray import ObjectRef

MAX_RAY_REASON = 200
CONNECT_S = 10.0
ENVIRONMENT = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_worker_niceness": "0"}
"""For a cluster started here: no usage reports, and tasks have the priority of local trials."""


class RayCluster:
    """A TaskCluster of Ray nodes. Ray trusts everybody who reaches it: a cluster belongs behind a firewall.

    `run_task` is a function of an importable module, which takes the path of a task's folder. Each task has `cores`
    cores. Without an `address` the cluster of this machine is joined, or one is started here, which listens on loopback
    only and has Ray's token authentication.
    """

    name = "ray"

    def __init__(self, address: str | None, cores: int, run_task: Callable[[str], object]) -> None:
        """Raises ConfigurationError if Ray is not installed, or not reached."""
        for name, value in ENVIRONMENT.items():
            os.environ.setdefault(name, value)
        try:
            import ray
        except ImportError:
            raise ConfigurationError("--engine ray: Ray is not installed: pip install 'gridtrack[ray]'") from None
        self._ray: Any = ray
        self._joined = not self._ray.is_initialized()
        if self._joined:
            self._join(address)
        options = {"num_cpus": cores, "max_retries": 0, "scheduling_strategy": "SPREAD"}
        self._task = self._ray.remote(**options)(run_task)
        nodes = (node["Resources"].get("CPU", 0.0) for node in self._ray.nodes() if node["Alive"])
        self.capacity = sum(int(cpus // cores) for cpus in nodes)

    def start(self, folders: Sequence[Path]) -> list[ObjectRef[Any]]:
        """Start the tasks in `folders`."""
        return [self._task.remote(str(folder)) for folder in folders]

    def ended(self, tasks: Sequence[ObjectRef[Any]]) -> Mapping[ObjectRef[Any], TaskEnd]:
        """The tasks among `tasks` that have ended."""
        done, _ = self._ray.wait(list(tasks), num_returns=len(tasks), timeout=0, fetch_local=False)
        return {task: self._end_of(task) for task in done}

    def cancel(self, tasks: Iterable[ObjectRef[Any]], *, force: bool) -> None:
        """Raise KeyboardInterrupt in `tasks`, or with `force` end their processes."""
        for task in tasks:
            self._ray.cancel(task, force=force)

    def close(self) -> None:
        """Leave the cluster, or end it if it was started here."""
        if self._joined:
            self._ray.shutdown()

    def _join(self, address: str | None) -> None:
        where = address or "this machine"
        try:
            if address not in (None, "auto", "local"):
                _knock(address)
            with _on_loopback(self._ray), _own_sigterm():
                self._ray.init(address, log_to_driver=False, include_dashboard=False, logging_level="error")
        except (ValueError, OSError, RuntimeError) as error:
            raise ConfigurationError(
                f"--engine ray: no Ray cluster at '{where}' ({one_line(str(error), MAX_RAY_REASON)}): start one with"
                " `ray start --head`, and give its address as --address HOST:PORT"
            ) from None

    def _end_of(self, task: ObjectRef[Any]) -> TaskEnd:
        errors = self._ray.exceptions
        try:
            self._ray.get(task)
        except (errors.RayTaskError, errors.TaskCancelledError, errors.RuntimeEnvSetupError) as error:
            return TaskEnd(lost=False, reason=_reason(error))
        except errors.RayError as error:
            return TaskEnd(lost=True, reason=_reason(error))
        return TaskEnd(lost=False, reason="")


@contextmanager
def _on_loopback(ray: Any) -> Iterator[None]:
    """A cluster that is started in the block listens on loopback only; joining one is not changed.

    Ray does that on macOS and Windows. Elsewhere there is no public way: Ray replaces even
    `_node_ip_address="127.0.0.1"` by an address of the network, and reads its environment variable at import only.
    """
    constants = ray._private.ray_constants
    before, constants.ENABLE_RAY_CLUSTER = constants.ENABLE_RAY_CLUSTER, False
    try:
        yield
    finally:
        constants.ENABLE_RAY_CLUSTER = before


@contextmanager
def _own_sigterm() -> Iterator[None]:
    """Keep the handler of SIGTERM: Ray's exits, without the summary of a run. Ray sets it in the main thread only."""
    before = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        if callable(before) and signal.getsignal(signal.SIGTERM) is not before:
            signal.signal(signal.SIGTERM, before)


def _knock(address: str) -> None:
    """Raise OSError or ValueError if nothing answers at HOST:PORT: Ray itself would try for minutes."""
    host, _, port = address.rpartition(":")
    socket.create_connection((host, int(port)), CONNECT_S).close()


def _reason(error: Exception) -> str:
    """The last line of a task's traceback, or the first of another error."""
    lines = [line for line in str(error).splitlines() if line.strip()] or [""]
    return f"{type(error).__name__}: {one_line(lines[-1] if 'Traceback' in str(error) else lines[0], MAX_RAY_REASON)}"
