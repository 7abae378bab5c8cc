"""A command that is ended by a signal, as a scheduler ends a job: what was scored is kept."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time

import psutil
import pytest

from gridtrack.recordings import packaged_recording


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM])
def test_a_comparison_that_is_ended_keeps_its_scores_and_leaves_no_process(tmp_path, end):
    rows = ["--tracker", "blank", "--tracker", "persistence", "--jobs", "1", "--every", "0.1s"]
    arguments = ["compare", f"{packaged_recording('leg_tracker')}@0s-40s", *rows, "--out", str(tmp_path / "run")]
    host = subprocess.Popen([sys.executable, "-m", "gridtrack.cli", *arguments], stderr=subprocess.DEVNULL)
    scores = tmp_path / "run" / "persistence@leg_tracker@0s-40s" / "scores.parquet.partial"
    while not scores.exists():
        assert host.poll() is None, "the comparison ended before the signal"
        time.sleep(0.02)
    family = psutil.Process(host.pid).children(recursive=True)
    host.send_signal(end)
    assert host.wait(60) == 130
    psutil.wait_procs(family, timeout=30)
    assert not [process for process in family if process.is_running() and process.status() != psutil.STATUS_ZOMBIE]
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["interrupted"] is True
    (finished,) = summary["trackers"]["blank"]["recordings"].values()
    assert finished["outcome"] == "ok"
