"""Display while trials run: the time left for all of them, and the table of a followed recording."""

import io
import math
import re
import threading
from types import SimpleNamespace

import pytest
from rich.console import Console

from gridtrack.evaluation.runs.live_scores import LiveRow, LiveStatus
from gridtrack.evaluation.runs.trial_record import TrialRecord
from gridtrack.reports import run_progress
from gridtrack.reports.run_progress import LiveTable, RunProgress


def record(frames=10):
    return TrialRecord(label="a", recording="hall", outcome="ok", frames_scored=frames, frames_expected=frames, steps=2)


@pytest.fixture
def clock(monkeypatch):
    """The clock of the display, which stands at `clock.now_s`."""
    clock = SimpleNamespace(now_s=0.0)
    monkeypatch.setattr(run_progress, "time", SimpleNamespace(monotonic=lambda: clock.now_s))
    return clock


def test_on_a_terminal_all_trials_have_a_bar_with_the_time_left(clock):
    console = Console(file=io.StringIO(), width=140, force_terminal=True)
    name = "dilated-convgru with the other weights of last week@a recording with a long name"
    with RunProgress(console) as progress:
        progress.planned({name: 100, "b@hall": 300})
        clock.now_s = 60.0
        progress.started(name, 100)
        for _ in range(100):
            progress.advanced(name)
        progress._bars.refresh()
        shown = console.file.getvalue()
        assert name in shown
        assert re.search(r"0 of 2 trials.*100/400 frames.*3 min 0 s left", shown)
        progress.ended(name, record())
    assert "1 of 2 trials" in console.file.getvalue()


def test_after_the_last_trial_the_measurements_and_the_summary_are_named():
    console = Console(file=io.StringIO(), width=140, force_terminal=False)
    with RunProgress(console) as progress:
        progress.planned({"a@hall": 10}, ["latency"])
        progress.started("a@hall", 10)
        progress.ended("a@hall", record())
    assert "(1 of 1 trials, then latency, then the summary)" in console.file.getvalue()


def test_a_long_start_is_announced_and_left_out_of_the_time_left(clock, monkeypatch):
    console, announced = Console(file=io.StringIO(), width=80, force_terminal=False), threading.Event()
    monkeypatch.setattr(run_progress, "RUNNING_LINE_EVERY_S", 0.0)
    with RunProgress(console) as progress:
        note = progress.note
        monkeypatch.setattr(progress, "note", lambda text: (note(text), announced.set()))
        progress.planned({"a@hall": 100})
        clock.now_s = 60.0
        progress.started("a@hall", 100)
        assert announced.wait(30)
        monkeypatch.setattr(run_progress, "RUNNING_LINE_EVERY_S", 30.0)
        for frame in range(50):
            clock.now_s = 160.0 if frame < 49 else 190.0
            progress.advanced("a@hall")
    start, *_, line = console.file.getvalue().splitlines()
    assert start.startswith("a@hall: starting; trackers with compiled code compile it in their first")
    assert line == "a@hall: 50/100 frames; 0 of 1 trials, 1 min 30 s left", "of 190 s a hundred were the start"


def test_without_a_terminal_lines_show_the_progress_of_all_trials(clock):
    console = Console(file=io.StringIO(), width=80, force_terminal=False)
    with RunProgress(console) as progress:
        progress.planned({"a@hall": 100, "b@hall": 100}, ["latency"])
        progress.started("a@hall", 100)
        progress.started("b@hall", 50)  # its thresholds are known already
        for _ in range(50):
            progress.advanced("a@hall")
        assert console.file.getvalue() == ""
        clock.now_s = 60.0
        progress.advanced("b@hall")
        progress.ended("a@hall", record())
        progress.ended("kept@hall", record())
    lines = console.file.getvalue().splitlines()
    assert lines == [
        "b@hall: 1/50 frames; 0 of 2 trials, 1 min 56 s left, then latency",
        "a@hall: ok, 10/10 forecasts scored, 0.0 s (1 of 2 trials, 29 s left, then latency)",
        "kept@hall: ok, 10/10 forecasts scored, 0.0 s",
    ]


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


def test_without_a_terminal_it_is_a_line_every_few_seconds():
    out = io.StringIO()
    with LiveTable(Console(file=out, width=200)) as table:
        table.update(lambda: STATUS)
        table.update(lambda: STATUS)
    assert out.getvalue() == (
        "41.2 s, 1.4 s behind the newest frame read; F1 dynamic at 1 s: persistence 0.112, 0 missed; [b] 0.187, 3"
        " missed; gone -, 9 missed\n"
    )


def test_on_a_terminal_it_is_a_table():
    out = io.StringIO()
    with LiveTable(Console(file=out, width=100, force_terminal=True, color_system=None)) as table:
        table.update(lambda: STATUS)
    lines = out.getvalue().splitlines()
    assert any(line.split() == ["persistence", "0.112", "34", "0", "in", "time"] for line in lines)
    assert any(line.split() == ["[b]", "0.187", "34", "3", "2", "frames", "old"] for line in lines)
    assert any(line.split() == ["gone", "-", "0", "9", "ended"] for line in lines)
