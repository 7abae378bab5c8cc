"""The progress of a run: bars on a terminal, plain lines elsewhere; both with the time left for all trials."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskID, TextColumn

from gridtrack.common.errors import printable
from gridtrack.evaluation.runs.trial_record import TrialRecord
from gridtrack.trackers.progress import duration_text

RUNNING_LINE_EVERY_S = 30.0
"""Without a terminal, time between two lines about a trial that is still running."""
STARTING = "starting; trackers with compiled code compile it in their first start on a machine, which takes minutes"
MIN_SHARE = 0.01
"""Share of the frames that must be delivered before the time left is estimated."""


class RunProgress:
    """The progress of a run. Its methods are called from several threads."""

    def __init__(self, console: Console | None = None) -> None:
        self._console = console or Console(stderr=True)
        self._bars = Progress(
            TextColumn("{task.description}"),
            BarColumn(bar_width=20),
            TextColumn("{task.completed}/{task.total} frames"),
            TextColumn("{task.fields[left]}"),
            console=self._console,
            disable=not self._console.is_terminal,
        )
        self._tasks: dict[str, TaskID] = {}
        self._lock = threading.Lock()
        self._frames: dict[str, int] = {}
        """Of each trial that is planned, has started or has ended in this run."""
        self._ended: set[str] = set()
        self._starting: dict[str, tuple[float, threading.Timer]] = {}
        """Of each trial that has received no frame yet, when it was started, and what tells so if it takes long."""
        self._then = ""
        self._delivered: dict[str, int] = {}
        self._began_s = self._last_line_s = time.monotonic()
        self._all: TaskID | None = None

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for _, timer in self._starting.values():
            timer.cancel()
        self._bars.stop()

    def note(self, text: str) -> None:
        """Print one line."""
        self._last_line_s = time.monotonic()
        self._console.print(escape(printable(text)), highlight=False, soft_wrap=True)

    def planned(self, frames: Mapping[str, int], then: Sequence[str] = ()) -> None:
        """The trials that will run, and about how many frames each will receive.

        `then`: what follows them; it is named beside the time left, which does not count it.
        """
        self._frames, self._then = dict(frames), "".join(f", then {what}" for what in then)
        self._began_s = time.monotonic()
        self._all = self._bars.add_task(self._all_text(), total=self._total(), left="")

    def started(self, trial: str, frames: int) -> None:
        """Show a bar for a trial of `frames` frames, which may start again where its machine was lost."""
        with self._lock:
            self._has_started(trial)
            if trial in self._tasks:
                self._bars.remove_task(self._tasks.pop(trial))
            self._frames[trial], self._delivered[trial] = frames, 0
            self._tasks[trial] = self._bars.add_task(escape(printable(trial)), total=frames, left="")
            timer = threading.Timer(RUNNING_LINE_EVERY_S, self.note, [f"{trial}: {STARTING}"])
            timer.daemon = True
            self._starting[trial] = time.monotonic(), timer
        timer.start()
        self._show_all()

    def advanced(self, trial: str) -> None:
        """Count one more frame that is delivered."""
        with self._lock:
            self._delivered[trial] += 1
            self._has_started(trial)
        self._bars.advance(self._tasks[trial])
        self._show_all()
        if not self._console.is_terminal and time.monotonic() - self._last_line_s >= RUNNING_LINE_EVERY_S:
            self.note(f"{trial}: {self._delivered[trial]}/{self._frames[trial]} frames; {self._overall()}")

    def ended(self, trial: str, record: TrialRecord) -> None:
        """Print the outcome of a trial that has ended, or is kept from an earlier run."""
        with self._lock:
            self._has_started(trial)
            if trial in self._tasks:
                self._bars.remove_task(self._tasks.pop(trial))
            if trial in self._frames:
                self._delivered[trial] = self._frames[trial]
                self._ended.add(trial)
        scored = f"{record.frames_scored}/{record.frames_expected} forecasts scored"
        reason = f": {record.reason}" if record.reason else ""
        overall = f" ({self._overall()})" if trial in self._ended and not self._console.is_terminal else ""
        self.note(f"{trial}: {record.outcome}, {scored}, {record.times.wall_s:.1f} s{overall}{reason}")
        self._show_all()

    def _has_started(self, trial: str) -> None:
        """The trial has received a frame, or has ended. Its start is left out of the rate, if nothing ran meanwhile."""
        if trial not in self._starting:
            return
        since_s, timer = self._starting.pop(trial)
        timer.cancel()
        if len(self._tasks) == 1:
            self._began_s += time.monotonic() - since_s

    def _show_all(self) -> None:
        if self._all is not None:
            done = sum(self._delivered.values())
            self._bars.update(
                self._all, description=self._all_text(), completed=done, total=self._total(), left=self._left()
            )

    def _total(self) -> int:
        return sum(self._frames.values())

    def _all_text(self) -> str:
        return f"{len(self._ended)} of {len(self._frames)} trials"

    def _left(self) -> str:
        """The time left for all trials at the rate so far; "" before it can be estimated."""
        with self._lock:
            share = sum(self._delivered.values()) / max(self._total(), 1)
        if share < MIN_SHARE or share >= 1.0:
            return ""
        return f"{duration_text((time.monotonic() - self._began_s) * (1.0 - share) / share)} left{self._then}"

    def _overall(self) -> str:
        return ", ".join(filter(None, (self._all_text(), self._left())))
