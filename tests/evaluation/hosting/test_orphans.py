"""A tracker that kills its own supervisor and leaves a process behind: the host ends it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

ENDED, LEFT = "86411", "86413"
"""Durations that no other process of this machine waits for, in seconds."""

pytestmark = [
    pytest.mark.usefixtures("burglar"),
    pytest.mark.skipif(sys.platform != "linux", reason="only Linux lets a process adopt the orphans below it"),
]


def left_behind(seconds: str) -> list[psutil.Process]:
    return [process for process in psutil.process_iter(["cmdline"]) if process.info["cmdline"] == ["sleep", seconds]]


def test_the_host_ends_what_is_left_behind_and_goes_on(record, tmp_path):
    rows = ["--tracker", f"burglar:attack=outlives,target='{ENDED}'", "--tracker", "persistence"]
    command = [sys.executable, "-m", "gridtrack.cli", "compare", str(record()), *rows, "--out", str(tmp_path / "run")]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == 3, ended.stderr
    assert left_behind(ENDED) == []
    found = json.loads(Path(tmp_path, "run", "summary.json").read_text())["trackers"]
    assert next(iter(found["persistence"]["recordings"].values()))["outcome"] == "ok"
    trial = next(iter(found["burglar"]["recordings"].values()))
    assert trial["outcome"] == "crashed"


def test_without_adoption_it_would_be_left(record, tmp_path):
    """The attack itself works: run from Python, where the process is not gridtrack's alone."""
    script = (
        "from gridtrack.trackers.selection import launch\n"
        "from gridtrack.common.grid import GridSpec\n"
        "from gridtrack.evaluation.hosting.limits import Limits\n"
        "from gridtrack.evaluation.hosting.tracker_process import TrackerProcess\n"
        "from gridtrack.trackers.contract import StreamSpec\n"
        "from pathlib import Path\n"
        f"options = {{'attack': 'outlives', 'target': '{LEFT}'}}\n"
        f"log = Path({str(tmp_path / 'stderr.log')!r})\n"
        "TrackerProcess(launch('burglar'), StreamSpec(GridSpec(), 0.125), options, Limits(), log).__enter__()\n"
    )
    ended = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert "TrialEnded" in ended.stderr
    left = left_behind(LEFT)
    assert len(left) == 1
    left[0].kill()
