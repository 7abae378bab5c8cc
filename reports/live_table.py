"""The table of a followed recording: it changes in place on a terminal, and is a line every few seconds elsewhere."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.live import Live
from rich.markup import escape
from rich.table import Table

from gridtrack.common.errors import printable
from gridtrack.evaluation.runs.live_scores import LiveRow, LiveStatus

SHOW_EVERY_S = 0.5
SHOW_LINE_EVERY_S = 10.0
"""Without a terminal, time between two lines."""


class LiveTable:
    """A LiveObserver, for standard error. A context manager."""

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
        """Show `status()`, where the one shown last is old enough."""
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
