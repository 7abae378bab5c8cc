"""Runs in real processes: whatever ends, kills or hangs, the scores are kept and no process is left."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys

import psutil
import pytest

from gridtrack.evaluation.runs.result_files import RunError
from gridtrack.evaluation.runs.summary import read_summary
from gridtrack.evaluation.runs.trial_record import read_trial_record

from scenes.agreement import wait_until
from scenes.room import trial_of

pytestmark = pytest.mark.usefixtures("staged")


@pytest.fixture
def start(settings, tmp_path):
    """`start(*trackers)` starts `gridtrack compare` of a run, as from a terminal; the process."""

    def start(*trackers):
        # a test run by nohup or in the background ignores some signals, and children inherit it
        program = ["env", "--default-signal", sys.executable, "-m", "gridtrack.cli"]
        rows = [word for tracker in trackers for word in ("--tracker", tracker)]
        options = ["--horizon", "1s", "--every", "0.5s", "--jobs", "2", "--out", str(tmp_path / "run"), "--no-floors"]
        return subprocess.Popen(
            [*program, "compare", *settings().recordings, *rows, *options], stderr=subprocess.DEVNULL
        )

    return start


@pytest.fixture
def begun(tmp_path):
    """`begun(trial)` waits until a trial has its first scores."""
    return lambda trial: wait_until(lambda: list((tmp_path / "run" / trial).glob("sums.parquet.*.partial")))


def children(process):
    return psutil.Process(process.pid).children(recursive=True)


def alive(processes):
    return [process for process in processes if process.is_running() and process.status() != psutil.STATUS_ZOMBIE]


def test_a_run_that_is_ended_keeps_its_scores_and_leaves_no_process(start, begun, tmp_path):
    """By SIGTERM; other signals have the same effect: test_cli.py."""
    host = start("persistence", "staged:crash_at=60,how=hangs")
    wait_until((tmp_path / "run" / "persistence@room" / "outcome.json").exists)
    begun("staged@room")
    family = children(host)
    host.send_signal(signal.SIGTERM)
    assert host.wait(60) == 130
    assert not alive(family)
    summary = read_summary(tmp_path / "run")
    assert summary.interrupted is True
    assert json.loads((tmp_path / "run" / "run.json").read_text())["status"] == "interrupted"
    assert trial_of(summary, "persistence").outcome == "ok"
    assert trial_of(summary, "staged").outcome == "interrupted"
    assert trial_of(summary, "staged").frames_scored < 16


def test_an_interrupt_while_a_tracker_starts_ends_the_run(start, tmp_path):
    host = start("staged:crash_at=1,crash_in=1,how=hangs")
    wait_until((tmp_path / "run" / "staged@room" / "stderr.log").exists)
    host.send_signal(signal.SIGINT)
    assert host.wait(60) == 130
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["interrupted"] is True


def test_a_folder_is_locked_until_its_run_has_ended_and_a_killed_run_is_resumed(
    start, begun, compare, progress, tmp_path, trackers_here
):
    trackers = ("persistence", f"staged:crash_at=60,how=hangs,starts={tmp_path / 'starts'}")
    host = start(*trackers)
    wait_until((tmp_path / "run" / "persistence@room" / "outcome.json").exists)
    begun("staged@room")
    for resume in (True, False):
        with pytest.raises(RunError, match=rf"run: in use by another run \(process {host.pid}\): wait until"):
            compare(*trackers, resume=resume)
    assert progress.delivered == {}
    family = children(host)
    host.kill()
    host.wait()
    wait_until(lambda: not alive(family))
    summary = compare(*trackers, resume=True)
    assert {trial_of(summary, label).outcome for label in ("persistence", "staged")} == {"ok"}
    assert set(progress.delivered) == {"staged@room"}


def test_a_tracker_that_is_killed_or_dies_ends_alone(start, begun, tmp_path):
    host = start("staged:crash_at=60,how=hangs", "persistence", "dies=staged:crash_at=60,how=dies")
    begun("staged@room")
    serves = ["gridtrack.trackers.serve", "staged"]
    victims = [p for p in alive(children(host)) if list(filter(None, p.cmdline()))[-2:] == serves]
    os.kill(victims[-1].pid, signal.SIGKILL)
    assert host.wait(60) == 3
    summary = read_summary(tmp_path / "run")
    assert trial_of(summary, "staged").outcome == "crashed"
    assert "SIGKILL" in trial_of(summary, "staged").reason
    assert read_trial_record(tmp_path / "run" / "staged@room").frames_scored < 16
    assert trial_of(summary, "dies").reason.startswith("update with frame 60: killed by SIGABRT")
    assert trial_of(summary, "persistence").outcome == "ok"


@pytest.mark.usefixtures("bad_trackers")
def test_the_round_trip_counts_where_the_trackers_clock_is_not_plausible(compare, record):
    """Its clock is that of its process: it would stop that of the host."""
    recordings = (str(record(seconds=15)),)
    summary = compare("stops-the-clock", "staged:sleep_s=0.015", recordings=recordings, latency=True, deadline=True)
    liar, honest = (trial_of(summary, label) for label in ("stops-the-clock", "staged"))
    assert (liar.latency_ms.clock, liar.deadline.clock) == ("host", "host")
    assert min(liar.latency_ms.update.p50, liar.latency_ms.predict.p50, liar.deadline.update_ms.p50) >= 15.0
    assert liar.deadline.highest_rate_hz < 1000 / 30
    assert liar.times.update_s >= 60 * 0.015
    assert (honest.latency_ms.clock, honest.deadline.clock) == ("tracker", "tracker")
    assert [notice for notice in map(str, summary.notices) if "the round trips count" in notice] == [
        "stops-the-clock on room: reports far shorter times than the round trips of its calls: the round trips count"
    ]
    latency = honest.latency_ms
    assert 0 < latency.predict_step.p50 < latency.predict.p50 <= latency.predict.p99
    assert len(latency.update.twentieths) == 21
    assert latency.predict.twentieths[10] == pytest.approx(latency.predict.p50, rel=1e-3)
    assert honest.deadline.update_ms.p50 >= 5.0
    assert honest.deadline.busy_ms.p99 >= honest.deadline.update_ms.p50
    assert honest.deadline.highest_rate_hz == pytest.approx(1000 / honest.deadline.busy_ms.p99, rel=0.02)
    assert honest.deadline.forecast_steps >= 12
    assert all(at.missed <= at.frames for at in honest.deadline.rates)
