"""A cluster of plain processes on this machine, with the interface for engines, without Ray."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Iterable, Mapping, Sequence
from multiprocessing.process import BaseProcess
from pathlib import Path

import psutil

from gridtrack.evaluation.engines import task as task_files
from gridtrack.evaluation.engines.remote import TaskEnd
from gridtrack.evaluation.runs.jobs import execute

SERVER = multiprocessing.get_context("forkserver")
SERVER.set_forkserver_preload(["gridtrack.evaluation.runs.jobs"])


class ProcessCluster:
    """Each task is a process; one that a signal ended counts as lost with its machine."""

    name, capacity = "processes", 2

    def __init__(self) -> None:
        self.started: list[BaseProcess] = []

    def start(self, folders: Sequence[Path]) -> list[BaseProcess]:
        tasks = [SERVER.Process(target=run_task, args=(str(folder), dict(os.environ))) for folder in folders]
        for task in tasks:
            task.start()
        self.started += tasks
        return tasks

    def ended(self, tasks: Sequence[BaseProcess]) -> Mapping[BaseProcess, TaskEnd]:
        codes = {task: task.exitcode for task in tasks}
        return {
            task: TaskEnd(lost=code < 0, reason=f"signal {-code}" if code < 0 else "")
            for task, code in codes.items()
            if code is not None
        }

    def cancel(self, tasks: Iterable[BaseProcess], *, force: bool) -> None:
        for task in tasks:
            signal_to(task, signal.SIGKILL if force else signal.SIGINT)

    def close(self) -> None:
        for task in self.started:
            task.join(60)

    def trackers(self) -> list[psutil.Process]:
        """The processes that tasks have started and that still run."""
        alive = (psutil.Process(task.pid) for task in self.started if task.is_alive())
        return [child for process in alive for child in process.children(recursive=True)]


def run_task(folder: str, environment: Mapping[str, str]) -> None:
    """Carry out a task with the environment of the test: the server of these processes began before it."""
    os.environ.update(environment)
    task_files.PROGRESS_S = task_files.WAKE_S  # a test does not wait for the progress
    execute(folder)


def signal_to(task: BaseProcess, number: int) -> None:
    """Send a signal to a task that may have ended."""
    if task.is_alive() and task.pid is not None:
        os.kill(task.pid, number)
