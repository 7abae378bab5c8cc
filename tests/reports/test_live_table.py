"""The table of a followed recording, on a terminal and elsewhere."""

from __future__ import annotations

import io
import math

from rich.console import Console

from gridtrack.evaluation.runs.live_scores import LiveRow, LiveStatus
from gridtrack.reports.live_table import LiveTable

STATUS = LiveStatus(
    41.2,
    1.4,
    "F1 dynamic at 1 s",
    [
        LiveRow("persistence", 0.1123, 34, 0, 0, ended=False),
        LiveRow("[b]", 0.187, 34, 3, 2, ended=False),
        LiveRow("gone", math.nan, 0, 9, None, ended=True),
    ],
)


def test_without_a_terminal_it_is_a_line_every_few_seconds() -> None:
    out = io.StringIO()
    with LiveTable(Console(file=out, width=200)) as table:
        table.update(lambda: STATUS)
        table.update(lambda: STATUS)
    assert out.getvalue() == (
        "41.2 s, 1.4 s behind the newest frame read; F1 dynamic at 1 s: persistence 0.112, 0 missed; [b] 0.187, 3"
        " missed; gone -, 9 missed\n"
    )


def test_on_a_terminal_it_is_a_table() -> None:
    out = io.StringIO()
    with LiveTable(Console(file=out, width=100, force_terminal=True, color_system=None)) as table:
        table.update(lambda: STATUS)
    lines = out.getvalue().splitlines()
    assert any(line.split() == ["persistence", "0.112", "34", "0", "in", "time"] for line in lines)
    assert any(line.split() == ["[b]", "0.187", "34", "3", "2", "frames", "old"] for line in lines)
    assert any(line.split() == ["gone", "-", "0", "9", "ended"] for line in lines)
