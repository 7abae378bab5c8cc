"""What the engine of a cluster needs of it: to start tasks, to tell which have ended, and to cancel them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, Protocol, TypeVar

Task = TypeVar("Task")


class TaskEnd(NamedTuple):
    """How a task ended: `lost` where its machine or its process was lost, so that it may run again; and why."""

    lost: bool
    reason: str


class TaskCluster(Protocol[Task]):
    """Runs tasks on its machines, each an attempt in a folder that all of them share."""

    name: str
    capacity: int
    """The number of tasks that its machines can run at the same time."""

    def start(self, folders: Sequence[Path]) -> list[Task]:
        """Start the attempts in `folders`. Raises EngineError."""

    def ended(self, tasks: Sequence[Task]) -> Mapping[Task, TaskEnd]:
        """Those of `tasks` that have ended. Raises EngineError where the cluster is lost."""

    def cancel(self, tasks: Iterable[Task], *, force: bool) -> None:
        """End `tasks`: by an interrupt that leaves them time to reply, or with `force` at once.

        Raises EngineError, with what may still run, where the cluster does not answer.
        """

    def close(self) -> None:
        """Leave the cluster. Raises EngineError as `cancel`."""
