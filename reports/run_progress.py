"""The progress of a run on standard error, with the time left: bars on a terminal, plain lines elsewhere.

For a followed recording it is a table that changes in place, or elsewhere a line every few seconds.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.live import Live
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskID, TextColumn
from rich.table import Table

from gridtrack.common.errors import printable
from gridtrack.evaluation.runs.live_scores import LiveRow, LiveStatus
from gridtrack.evaluation.runs.trial_record import TrialRecord
from gridtrack.trackers.training.progress import duration_text

RUNNING_LINE_EVERY_S = 30.0
"""Without a terminal, time between two lines about a trial that is still running."""
STARTING = "starting; trackers with compiled code compile it in their first start on a machine, which takes minutes"
MIN_SHARE = 0.01
"""Share of the frames that must be delivered before the time left is estimated."""
SHOW_EVERY_S = 0.5
SHOW_LINE_EVERY_S = 10.0
"""Without a terminal, time between two lines."""


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
        """By trial: every trial that is planned, has started or has ended in this run."""
        self._ended: set[str] = set()
        self._starting: dict[str, tuple[float, threading.Timer]] = {}
        """By trial without a frame yet: its start, and the timer of the message about a long start."""
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
        """The trials that will run, and the approximate number of frames of each.

        `then`: the work after them, which is named beside the time left but not included in it.
        """
        self._frames, self._then = dict(frames), "".join(f", then {what}" for what in then)
        self._began_s = time.monotonic()
        self._all = self._bars.add_task(self._all_text(), total=self._total(), left="")

    def started(self, trial: str, frames: int) -> None:
        """Show a bar for a trial of `frames` frames; a trial on a lost machine starts again."""
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
        """Print the outcome of a trial that ended now or in an earlier run."""
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
        """The trial has received a frame, or has ended. If it ran alone, its start does not count for the rate."""
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
        """The time left for all trials at the current rate, or what follows; "" before it can be estimated."""
        with self._lock:
            share = sum(self._delivered.values()) / max(self._total(), 1)
        if share >= 1.0:
            return f"{self._then}, then the summary".removeprefix(", ")
        if share < MIN_SHARE:
            return ""
        return f"{duration_text((time.monotonic() - self._began_s) * (1.0 - share) / share)} left{self._then}"

    def _overall(self) -> str:
        return ", ".join(filter(None, (self._all_text(), self._left())))


class LiveTable:
    """A LiveObserver that writes to standard error. A context manager."""

    def __init__(self, console: Console | None = None) -> None:
        self._console = console or Console(stderr=True)
        self._live = Live(console=self._console, auto_refresh=False, transient=True)
        self._shown_s = -math.inf

    def __enter__(self) -> Self:
        if self._console.is_terminal:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._live.stop()

    def note(self, text: str) -> None:
        """Print one line."""
        self._console.print(escape(printable(text)), highlight=False, soft_wrap=True)

    def update(self, status: Callable[[], LiveStatus]) -> None:
        """Show `status()`, unless the table was shown a moment ago."""
        terminal = self._console.is_terminal
        if time.monotonic() - self._shown_s < (SHOW_EVERY_S if terminal else SHOW_LINE_EVERY_S):
            return
        self._shown_s = time.monotonic()
        if terminal:
            self._live.update(live_table(status()), refresh=True)
        else:
            self.note(live_line(status()))


def live_table(status: LiveStatus) -> Table:
    """The status as a table, a row for each tracker."""
    table = Table(title=_time_text(status), title_justify="left", box=None, pad_edge=False)
    table.add_column("tracker")
    for heading in (status.score, "forecasts", "missed", "newest forecast"):
        table.add_column(heading, justify="right")
    for row in status.rows:
        table.add_row(escape(printable(row.label)), _f1_text(row), str(row.forecasts), str(row.missed), _age_text(row))
    return table


def live_line(status: LiveStatus) -> str:
    """The status as one line."""
    rows = (f"{row.label} {_f1_text(row)}, {row.missed} missed" for row in status.rows)
    return f"{_time_text(status)}; {status.score}: {'; '.join(rows)}"


def _time_text(status: LiveStatus) -> str:
    return f"{status.time_s:.1f} s, {status.behind_s:.1f} s behind the newest frame read"


def _f1_text(row: LiveRow) -> str:
    return "-" if math.isnan(row.f1) else f"{row.f1:.3f}"


def _age_text(row: LiveRow) -> str:
    if row.ended:
        return "ended"
    if row.age_frames is None:
        return "-"
    return "in time" if row.age_frames == 0 else f"{row.age_frames} frames old"
