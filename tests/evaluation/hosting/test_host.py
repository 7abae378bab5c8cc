"""The host: traces of the recording in /proc, and processes that a tracker leaves behind."""

from __future__ import annotations

import ctypes
import json
import os
import subprocess
import sys
from pathlib import Path

import psutil
import pytest

from gridtrack.evaluation.hosting.host import shielded_environment

PR_CAPBSET_DROP = 24
CAP_SYS_PTRACE, CAP_SYS_ADMIN, CAP_PERFMON = 19, 21, 38
ENDED, LEFT = "86411", "86413"
"""Unusual durations, seconds, that identify the processes of this test."""

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="/proc, and the adoption of orphans, are Linux's")


def drop_tracing() -> None:
    """Remove root's right to read every process, which no shield prevents."""
    for right in (CAP_SYS_PTRACE, CAP_SYS_ADMIN, CAP_PERFMON):
        ctypes.CDLL(None).prctl(PR_CAPBSET_DROP, right, 0, 0, 0)


@pytest.mark.parametrize(("command", "tracker"), [("compare", "nosy-in-trial"), ("train", "nosy")])
@pytest.mark.usefixtures("nosy")
def test_no_argument_environment_or_descriptor_names_the_recording(command, tracker, record, tmp_path):
    path, found = record("hidden-name"), tmp_path / "found.json"
    selection = f"{tracker}:found={found},secret=eman-neddih"
    compared = ["--no-floors", str(path), "--tracker", selection, "--horizon", "0.5s", "--every", "0.5s"]
    options = [selection, str(path)] if command == "train" else compared
    argv = [sys.executable, "-m", "gridtrack.cli", command, *options, "--out", str(tmp_path / "out")]
    environment = os.environ | {"RECORDING": str(path)}
    subprocess.run(argv, check=True, stdout=subprocess.DEVNULL, env=environment, preexec_fn=drop_tracing)
    assert json.loads(found.read_text())["traces"] == []


def test_variables_that_name_a_recording_are_left_out(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("RECORDING", "somewhere/a.mcap")
    monkeypatch.setenv("FOLDER", f"{tmp_path}/bag/metadata.yaml")
    monkeypatch.setenv("OTHER", "bag")
    found = shielded_environment([Path("a.mcap"), Path("bag")])
    assert found == {name: value for name, value in os.environ.items() if name not in ("RECORDING", "FOLDER")}


def left_behind(seconds: str) -> list[psutil.Process]:
    return [process for process in psutil.process_iter(["cmdline"]) if process.info["cmdline"] == ["sleep", seconds]]


@pytest.mark.usefixtures("burglar")
def test_the_host_ends_the_processes_of_a_tracker_that_killed_its_supervisor_and_continues(record, tmp_path):
    rows = ["--no-floors", "--tracker", f'burglar:attacks=[["outlives","{ENDED}"]]', "--tracker", "persistence"]
    rows += ["--horizon", "0.5s", "--every", "0.5s"]
    command = [sys.executable, "-m", "gridtrack.cli", "compare", str(record()), *rows, "--out", str(tmp_path / "run")]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == 3, ended.stderr
    assert left_behind(ENDED) == []
    found = json.loads(Path(tmp_path, "run", "summary.json").read_text())["trackers"]
    outcomes = {name: next(iter(row["recordings"].values()))["outcome"] for name, row in found.items()}
    assert outcomes == {"burglar": "crashed", "persistence": "ok"}


@pytest.mark.usefixtures("burglar")
def test_without_adoption_the_process_would_remain(tmp_path):
    """The attack works in a program that is not gridtrack alone, and therefore adopts no orphans."""
    script = f"""
from pathlib import Path
from gridtrack.common.grid import GridSpec
from gridtrack.evaluation.hosting.limits import Limits
from gridtrack.evaluation.hosting.tracker_process import TrackerProcess
from gridtrack.trackers.contract import StreamSpec
from gridtrack.trackers.selection import launch
options, log = {{"attacks": [["outlives", {LEFT!r}]]}}, Path({str(tmp_path / "stderr.log")!r})
TrackerProcess(launch("burglar"), StreamSpec(GridSpec(), 0.125), options, Limits(), log).__enter__().reset(0)
"""
    # the tracker may answer once more before it ends with its supervisor: with or without an error
    subprocess.run([sys.executable, "-c", script], capture_output=True, check=False)
    left = left_behind(LEFT)
    for process in left:
        process.kill()
    assert len(left) == 1
