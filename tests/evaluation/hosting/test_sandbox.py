"""`--sandbox`: what a hostile tracker gets inside it, and for each attack that it succeeds without one."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gridtrack.common.errors import ConfigurationError
from gridtrack.common.grid import GridSpec
from gridtrack.evaluation.hosting.limits import Limits
from gridtrack.evaluation.hosting.outcome import TrialEnded
from gridtrack.evaluation.hosting.sandbox import check_sandbox, code_folders
from gridtrack.evaluation.hosting.tracker_process import TrackerProcess
from gridtrack.evaluation.runs.summary import read_summary
from gridtrack.trackers.contract import StreamSpec
from gridtrack.trackers.selection import Launch, launch

MEMORY_MB = 400
Attack = Callable[..., Any]


def _unavailable() -> str:
    try:
        check_sandbox()
    except ConfigurationError as error:
        return str(error)
    return ""


pytestmark = pytest.mark.skipif(bool(_unavailable()), reason=_unavailable())


@pytest.fixture
def attack(burglar, tmp_path) -> Attack:
    """`attack(name, target, sandbox=True)` starts the burglar, and gives what it found."""

    default = tmp_path / "run" / "burglar@room" / "stderr.log"

    def attack(
        name: str,
        target: object = "",
        confined: bool = True,
        recordings: tuple[Path, ...] = (),
        log: Path = default,
    ) -> Any:
        log.parent.mkdir(parents=True, exist_ok=True)
        limits, options = Limits(memory_mb=MEMORY_MB, sandbox=confined), {"attack": name, "target": str(target)}
        with TrackerProcess(launch("burglar"), StreamSpec(GridSpec(20, 0.2), 0.125), options, limits, log, recordings):
            pass
        return json.loads(log.read_text().partition("found: ")[2])

    return attack


@pytest.mark.parametrize("confined", [False, True], ids=["open", "sandbox"])
def test_no_file_of_the_user_is_read_or_changed(attack, tmp_path, confined):
    secret = tmp_path / "recording.mcap"
    secret.write_bytes(b"recorded")
    assert attack("reads", secret, confined) == ("" if confined else b"recorded".hex())
    attack("rewrites", secret, confined)  # inside it writes to its own memory, where there is a folder of this name
    assert secret.read_bytes() == (b"recorded" if confined else b"burglar")


def test_recordings_and_runs_in_its_own_folder_are_hidden(attack, tmp_path):
    own = tmp_path / "site"  # PYTHONPATH names it
    bag, scans = own / "bag", own / "scans.mcap"
    bag.mkdir(exist_ok=True)
    for path in (scans, bag / "metadata.yaml", own / "notes.txt"):
        path.write_bytes(b"recorded")
    assert attack("reads", own / "notes.txt") == b"recorded".hex()
    assert attack("reads", scans) == b"recorded".hex()
    assert attack("reads", scans, recordings=(scans, bag)) == ""
    assert attack("reads", bag / "metadata.yaml", recordings=(scans, bag)) == ""


@pytest.mark.parametrize("place", ["burglar@room", ".engine/tmp1/3.1/files"], ids=["local", "cluster"])
def test_the_forecasts_of_the_other_trials_of_its_run_are_hidden(attack, tmp_path, place):
    """Their samples show the future of the frames that it receives."""
    run = tmp_path / "site" / "run"
    samples = run / "persistence@room" / "forecasts.mcap"
    samples.parent.mkdir(parents=True)
    samples.write_bytes(b"recorded")
    assert attack("reads", samples, False, log=run / place / "stderr.log") == b"recorded".hex()
    assert attack("reads", samples, log=run / place / "stderr.log") == ""


@pytest.mark.parametrize("confined", [False, True], ids=["open", "sandbox"])
def test_no_server_is_reached(attack, confined):
    with socket.create_server(("127.0.0.1", 0)) as server:
        assert attack("calls", server.getsockname()[1], confined) is not confined


@pytest.mark.parametrize("confined", [False, True], ids=["open", "sandbox"])
def test_no_other_process_is_seen_read_or_ended(attack, confined):
    with subprocess.Popen(["sleep", "3600"]) as other:
        assert any("sleep 3600" in line for line in attack("looks", confined=confined)) is not confined
        assert attack("reads_memory", other.pid, confined) is not confined
        assert attack("kills", other.pid, confined) is not confined
        assert (other.poll() is None) is confined
        other.kill()


def test_whoever_ends_all_processes_in_sight_ends_only_itself(attack):
    """bwrap's own process in the sandbox is the first one of its namespace, which no signal from inside reaches."""
    assert attack("kills_all") is False


def test_files_can_be_made_in_its_own_memory_only(attack):
    folders = attack("writes")
    assert {"/tmp", "/dev/shm"} <= set(folders)
    elsewhere = [path for path in folders if not path.startswith(("/tmp", "/dev/shm"))]
    assert [path for path in elsewhere if Path(path).name != "__pycache__"] == []


@pytest.mark.parametrize("folder", ["/tmp", "/dev/shm"])
def test_files_in_its_memory_count_as_memory(attack, folder):
    with pytest.raises(TrialEnded, match=f"more than {MEMORY_MB} MB of resident memory"):
        attack("fills", folder)
    assert not Path(folder, "burglar").exists()


@pytest.mark.parametrize("confined", [False, True], ids=["open", "sandbox"])
def test_it_gets_no_namespace_in_which_it_has_rights(attack, confined):
    assert attack("makes_a_namespace", confined=confined) is not confined


def test_its_environment_has_no_variable_of_the_user(attack, monkeypatch):
    monkeypatch.setenv("TOKEN", "secret")
    assert "TOKEN" in attack("variables", confined=False)
    found = attack("variables")
    assert "TOKEN" not in found
    assert (found["HOME"], found["TMPDIR"]) == ("/tmp", "/tmp")


def test_scores_are_those_without_a_sandbox(record, tmp_path):
    rows = ["--tracker", "persistence", "--tracker", "static-map"]
    for name, options in (("open", []), ("confined", ["--sandbox"])):
        assert gridtrack("compare", str(record()), *rows, *options, "--out", str(tmp_path / name)).returncode == 0
    scores = [
        {label: row.recordings for label, row in read_summary(tmp_path / name).trackers.items()}
        for name in ("open", "confined")
    ]
    for label in scores[0]:
        for name, trial in scores[0][label].items():
            assert trial.strata == scores[1][label][name].strata


def test_a_program_in_its_own_folder_runs(tmp_path):
    """A command of `trackers.toml`: it sees its folder, and its answer comes through."""
    own, log = tmp_path / "own", tmp_path / "run" / "x@y" / "stderr.log"
    log.parent.mkdir(parents=True)
    own.mkdir()
    program = own / "program"
    program.write_text("#!/bin/sh\nls / >&2; cat notes >&2; exit 7\n")
    program.chmod(0o755)
    (own / "notes").write_text("its own notes\n")
    started = Launch("program", (str(program),), own)
    stream = StreamSpec(GridSpec(20, 0.2), 0.125)
    with pytest.raises(TrialEnded, match=r"exited with code 7 \(its own notes\)"):
        TrackerProcess(started, stream, {}, Limits(sandbox=True), log).__enter__()
    assert "home" not in log.read_text().split()


def test_a_signal_that_ended_the_program_is_named(tmp_path):
    log = tmp_path / "stderr.log"
    started = Launch("program", ("sh", "-c", "kill -SEGV $$"), tmp_path)
    with pytest.raises(TrialEnded, match="killed by SIGSEGV"):
        TrackerProcess(started, StreamSpec(GridSpec(20, 0.2), 0.125), {}, Limits(sandbox=True), log).__enter__()


def test_the_code_of_another_environment_is_seen(tmp_path):
    environment, project = tmp_path / "env", tmp_path / "my tracker"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(environment)], check=True)
    info = next(environment.glob("lib/python*/site-packages")) / "my_tracker-1.0.dist-info"
    info.mkdir()
    told = {"url": project.as_uri(), "dir_info": {"editable": True}}
    (info / "direct_url.json").write_text(json.dumps(told))
    folders = code_folders(str(environment / "bin" / "python"), tmp_path / "cwd", {})
    assert {environment, project, tmp_path / "cwd"} <= set(folders)
    (info / "direct_url.json").write_text("[" * 10_000)
    assert project not in code_folders(str(environment / "bin" / "python"), None, {})


def test_without_bubblewrap_one_line_says_what_to_install(record, monkeypatch):
    monkeypatch.setenv("PATH", os.fspath(Path(sys.executable).parent))
    ended = gridtrack("compare", str(record()), "--tracker", "persistence", "--sandbox")
    assert ended.returncode == 2
    assert len(ended.stderr.strip().splitlines()) == 1
    assert "--sandbox: bubblewrap is not installed" in ended.stderr


def gridtrack(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run the command."""
    command = [sys.executable, "-m", "gridtrack.cli", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)
