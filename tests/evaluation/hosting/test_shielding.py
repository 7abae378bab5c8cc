"""What /proc shows a tracker's process of the recording, in its own entries and in those of its ancestors."""

from __future__ import annotations

import ctypes
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from gridtrack.evaluation.hosting.host import shielded_environment
from tests.conftest import PLUGINS

PR_CAPBSET_DROP = 24
CAP_SYS_PTRACE, CAP_SYS_ADMIN, CAP_PERFMON = 19, 21, 38

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="/proc is Linux's")


def drop_tracing() -> None:
    """Take the right to read every process from root; no shield prevents that."""
    for right in (CAP_SYS_PTRACE, CAP_SYS_ADMIN, CAP_PERFMON):
        ctypes.CDLL(None).prctl(PR_CAPBSET_DROP, right, 0, 0, 0)


PYTHON = "import gridtrack; gridtrack.compare({path!r}, trackers={selection!r}, out={out!r})"


@pytest.mark.parametrize(
    ("command", "tracker"), [("compare", "nosy-in-trial"), ("train", "nosy"), ("python", "nosy-in-trial")]
)
def test_no_argument_environment_or_descriptor_names_the_recording(command, tracker, record, install, tmp_path):
    install(
        "nosy",
        {"nosy": "nosy_trackers:Nosy", "nosy-in-trial": "nosy_trackers:NosyInTrial"},
        {"nosy_trackers.py": (PLUGINS / "nosy_trackers.py").read_text()},
    )
    path, found = record("hidden-name"), tmp_path / "found.json"
    selection = f"{tracker}:found={found},secret=eman-neddih"
    options = [selection, str(path)] if command == "train" else [str(path), "--tracker", selection]
    words = ["-m", "gridtrack.cli", command, *options, "--out", str(tmp_path / "out")]
    if command == "python":
        words = ["-c", PYTHON.format(path=str(path), selection=selection, out=str(tmp_path / "out"))]
    argv = [sys.executable, *words]
    subprocess.run(
        argv, check=True, stdout=subprocess.DEVNULL, env=os.environ | {"RECORDING": str(path)}, preexec_fn=drop_tracing
    )
    assert json.loads(found.read_text())["traces"] == []


def test_variables_that_name_a_recording_are_left_out(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("RECORDING", "somewhere/a.mcap")
    monkeypatch.setenv("FOLDER", f"{tmp_path}/bag/metadata.yaml")
    monkeypatch.setenv("OTHER", "bag")
    found = shielded_environment([Path("a.mcap"), Path("bag")])
    assert found == {name: value for name, value in os.environ.items() if name not in ("RECORDING", "FOLDER")}
