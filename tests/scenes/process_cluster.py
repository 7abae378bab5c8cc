"""A cluster of plain processes on this machine: what an engine asks of a cluster, without Ray."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import psutil

from gridtrack.evaluation.engines.remote import TaskEnd

EXECUTE = "import sys; from gridtrack.evaluation.runs.jobs import execute; execute(sys.argv[1])"


class ProcessCluster:
    """Each task is a process; one that a signal ended counts as lost with its machine."""

    name = "processes"

    def __init__(self, capacity: int = 2) -> None:
        self.capacity = capacity
        self.started: list[subprocess.Popen[bytes]] = []
        self.folders: list[Path] = []

    def start(self, folders: Sequence[Path]) -> list[subprocess.Popen[bytes]]:
        tasks = [subprocess.Popen([sys.executable, "-c", EXECUTE, str(folder)]) for folder in folders]
        self.started += tasks
        self.folders += folders
        return tasks

    def ended(self, tasks: Sequence[subprocess.Popen[bytes]]) -> Mapping[subprocess.Popen[bytes], TaskEnd]:
        codes = {task: task.poll() for task in tasks}
        return {
            task: TaskEnd(lost=code < 0, reason=f"signal {-code}" if code < 0 else "")
            for task, code in codes.items()
            if code is not None
        }

    def cancel(self, tasks: Iterable[subprocess.Popen[bytes]], *, force: bool) -> None:
        for task in tasks:
            task.send_signal(signal.SIGKILL if force else signal.SIGINT)

    def close(self) -> None:
        for task in self.started:
            task.wait(60)

    def trackers(self) -> list[psutil.Process]:
        """The processes that tasks have started and that still run."""
        alive = (psutil.Process(task.pid) for task in self.started if task.poll() is None)
        return [child for process in alive for child in process.children(recursive=True)]
