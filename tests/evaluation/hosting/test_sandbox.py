"""`--sandbox`: the results of a hostile tracker inside it, and for each attack that it succeeds without one."""

from __future__ import annotations

import fcntl
import json
import mmap
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any
from uuid import uuid4

import pytest

from gridtrack.common.errors import ConfigurationError
from gridtrack.common.grid import GridSpec
from gridtrack.evaluation.hosting import sandbox
from gridtrack.evaluation.hosting.limits import Limits
from gridtrack.evaluation.hosting.outcome import TrialEnded
from gridtrack.evaluation.hosting.sandbox import check_sandbox, code_folders, confine, copies_of
from gridtrack.evaluation.hosting.supervisor import used
from gridtrack.evaluation.hosting.tracker_process import TrackerProcess
from gridtrack.evaluation.runs.plan import resolve
from gridtrack.trackers.contract import StreamSpec
from gridtrack.trackers.selection import Launch, launch

from scenes.own_forecasts import own_forecasts
from scenes.room import trial_of

MEMORY_MB = 400
SESSION_KEYRING, USER_KEYRING = -3, -4
STREAM = StreamSpec(GridSpec(20, 0.2), 0.125)
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
    """`attack(*attacks)` starts the burglar with attacks and their targets, and returns the result of each."""
    default = tmp_path / "run" / "burglar@room" / "stderr.log"

    def attack(
        *attacks: tuple[str, object], confined: bool = True, recordings: tuple[Path, ...] = (), log: Path = default
    ) -> list[Any]:
        log.parent.mkdir(parents=True, exist_ok=True)
        options = {"attacks": [(name, str(target)) for name, target in attacks]}
        limits = Limits(memory_mb=MEMORY_MB, sandbox=confined)
        with TrackerProcess(launch("burglar"), STREAM, options, limits, log, recordings):
            pass
        found: list[Any] = json.loads(log.read_text().partition("found: ")[2])
        return found

    return attack


@pytest.mark.parametrize("confined", [False, True], ids=["open", "sandbox"])
def test_no_file_server_process_or_variable_of_the_user_is_reached(attack, tmp_path, monkeypatch, confined):
    secret = tmp_path / "recording.mcap"
    secret.write_bytes(b"recorded")
    monkeypatch.setenv("TOKEN", "secret")
    other = subprocess.Popen(["sleep", "3600"])
    try:
        with socket.create_server(("127.0.0.1", 0)) as server:
            read, _, called, seen, memory_read, killed, variables, namespace = attack(
                ("reads", secret),
                ("rewrites", secret),  # inside it writes to its own memory, where there is a folder of this name
                ("calls", server.getsockname()[1]),
                ("looks", ""),
                ("reads_memory", other.pid),
                ("kills", other.pid),
                ("variables", ""),
                ("makes_a_namespace", ""),
                confined=confined,
            )
        assert (other.poll() is None) is confined
    finally:
        other.kill()
        other.wait()
    assert read == ("" if confined else b"recorded".hex())
    assert secret.read_bytes() == (b"recorded" if confined else b"burglar")
    assert any("sleep 3600" in line for line in seen) is not confined
    assert [called, memory_read, killed, namespace] == [not confined] * 4
    assert ("TOKEN" in variables) is not confined
    if confined:
        assert (variables["HOME"], variables["TMPDIR"]) == ("/tmp", "/tmp")


def test_recordings_and_runs_in_its_own_folder_are_hidden(attack, tmp_path):
    own = tmp_path / "site"  # PYTHONPATH names it
    bag, scans = own / "bag", own / "scans.mcap"
    bag.mkdir(exist_ok=True)
    files = {scans: b"recorded", bag / "metadata.yaml": b"recorded", own / "notes.txt": b"my notes"}
    for path, content in files.items():
        path.write_bytes(content)
    reads = [("reads", path) for path in files]
    assert attack(*reads) == [content.hex() for content in files.values()]
    assert attack(*reads, recordings=(scans, bag)) == ["", "", b"my notes".hex()]


@pytest.mark.parametrize("place", ["burglar@room", ".engine/tmp1/3.1/files"], ids=["local", "cluster"])
def test_the_forecasts_of_the_other_trials_of_its_run_are_hidden(attack, tmp_path, place):
    """Their samples show the future of the frames that it receives."""
    run = tmp_path / "site" / "run"
    samples = run / "persistence@room" / "forecasts.mcap"
    samples.parent.mkdir(parents=True)
    samples.write_bytes(b"recorded")
    log = run / place / "stderr.log"
    assert attack(("reads", samples), confined=False, log=log) == [b"recorded".hex()]
    assert attack(("reads", samples), log=log) == [""]


def test_a_copy_of_the_recording_in_its_own_folder_is_hidden(attack, tmp_path):
    """Under whatever name: a tracker could ship the recordings that it is likely to meet."""
    scans, copy, other = tmp_path / "scans.mcap", tmp_path / "site" / "weights.bin", tmp_path / "site" / "notes"
    copy.parent.mkdir(exist_ok=True)
    for path, content in ((scans, b"recorded"), (copy, b"recorded"), (other, b"of equal")):
        path.write_bytes(content)
    found = attack(("reads", copy), ("reads", other), recordings=(scans,))
    assert found == ["", b"of equal".hex()]


def test_links_in_a_circle_hide_no_copy_of_the_recording(tmp_path):
    recording, folder = tmp_path / "scans.mcap", tmp_path / "site"
    folder.mkdir()
    recording.write_bytes(b"recorded")
    copies = [folder / f"copy-{n}" for n in range(20)]  # a folder is listed in any order
    for n, copy in enumerate(copies):
        copy.write_bytes(b"recorded")
        (folder / f"circle-{n}").symlink_to(folder / f"circle-{n}")
    assert sorted(copies_of((recording,), (folder,))) == sorted(copies)


def test_recordings_that_come_with_gridtrack_are_hidden_in_an_ordinary_installation(tmp_path):
    data = tmp_path / "env" / "lib" / "python3.11" / "site-packages" / "gridtrack" / "data"
    data.mkdir(parents=True)
    environment = tmp_path / "env"
    argv = Launch("program", (str(environment / "bin" / "python"),), None)
    (environment / "pyvenv.cfg").write_text("")
    command, _ = confine(argv, {}, MEMORY_MB, (), (), (), 9)
    assert command[command.index(str(data)) - 1] == "--tmpfs"


@pytest.mark.parametrize("confined", [False, True], ids=["open", "sandbox"])
def test_no_key_of_the_kernel_outlives_its_process(attack, confined):
    attack(("leaves_a_key", SESSION_KEYRING), ("leaves_a_key", USER_KEYRING), confined=confined)
    found = attack(("finds_a_key", SESSION_KEYRING), ("finds_a_key", USER_KEYRING), confined=confined)
    assert found == [False, not confined]


@pytest.mark.parametrize("confined", [False, True], ids=["open", "sandbox"])
def test_the_pages_that_a_file_has_in_memory_cannot_be_asked(attack, tmp_path, confined):
    """A tracker could read some pages of its own files in one pass, and look for them in the next."""
    own = tmp_path / "site" / "weights.bin"
    own.parent.mkdir(exist_ok=True)
    with own.open("wb") as file:
        file.write(bytes(16 * mmap.PAGESIZE))
        os.fsync(file)
    _, found = attack(("leaves_pages", own), ("finds_pages", own), confined=confined)
    assert len(found) == (0 if confined else 16)


@pytest.mark.parametrize("confined", [False, True], ids=["open", "sandbox"])
def test_locks_on_a_file_that_two_trackers_read_tell_them_nothing(attack, tmp_path, confined):
    own = tmp_path / "site" / "weights.bin"
    own.parent.mkdir(exist_ok=True)
    own.write_bytes(b"weights")
    with own.open("rb") as file:
        fcntl.lockf(file, fcntl.LOCK_SH)
        fcntl.flock(file, fcntl.LOCK_SH)
        (found,) = attack(("senses_locks", own), confined=confined)
    every = ["inotify", "F_GETLK", "F_OFD_GETLK", "flock", "F_SETLEASE", "/proc/locks"]
    assert found == ([] if confined else every)


@pytest.mark.parametrize("confined", [False, True], ids=["open", "sandbox"])
def test_no_file_is_a_memory_of_a_recording_for_a_later_pass(attack, confined):
    """Also not in the two folders that it may write to."""
    places = [Path(folder, f"memory-{uuid4()}") for folder in ("/tmp", "/dev/shm")]
    try:
        attack(*[("rewrites", place) for place in places], confined=confined)
        found = attack(*[("reads", place) for place in places], confined=confined)
    finally:
        for place in places:
            place.unlink(missing_ok=True)
    assert found == ["" if confined else b"burglar".hex()] * 2


def test_it_writes_to_its_own_memory_only_and_ends_only_itself(attack):
    """bwrap's own process in the sandbox is the first one of its namespace, which no signal from inside reaches."""
    folders, killed = attack(("writes", ""), ("kills_all", ""))
    assert {"/tmp", "/dev/shm"} <= set(folders)
    elsewhere = [path for path in folders if not path.startswith(("/tmp", "/dev/shm"))]
    assert [path for path in elsewhere if Path(path).name != "__pycache__"] == []
    assert killed is False


@pytest.mark.parametrize("folder", ["/tmp", "/dev/shm"])
def test_files_in_its_memory_count_as_memory(attack, folder):
    with pytest.raises(TrialEnded, match=f"more than {MEMORY_MB} MB of resident memory"):
        attack(("fills", folder))
    assert not Path(folder, "burglar").exists()


def test_files_of_the_host_do_not_count_while_the_sandbox_mounts_its_own(tmp_path):
    """Once in some thousand starts the size of the host's /tmp was taken for the sandbox's own."""
    place, other = tmp_path / "place", tmp_path / "other"
    ended = threading.Event()
    ((disk, _), on_disk), *_ = used("/").items()

    def mounts() -> None:
        while not ended.is_set():
            for folder in ("/", "/dev/shm"):
                other.symlink_to(folder)
                other.replace(place)

    mounting = threading.Thread(target=mounts)
    mounting.start()
    try:
        found = [used(str(place)) for _ in range(5000)]
    finally:
        ended.set()
        mounting.join()
    in_memory = [size for one in found for (device, _), size in one.items() if device != disk]
    assert in_memory
    assert max(in_memory) < on_disk / 2


def test_scores_are_equal_with_and_without_the_sandbox(compare, record, tmp_path):
    """Also of recorded forecasts: their file is seen."""
    own_forecasts(tmp_path / "mine.npz", record())
    scores = []
    for confined in (False, True):
        limits, out = Limits(sandbox=confined), tmp_path / f"run {confined}"
        summary = compare("persistence", f"mine=recorded:file={tmp_path / 'mine.npz'}", limits=limits, out=out)
        scores.append([trial_of(summary, label).strata for label in ("persistence", "mine")])
    assert scores[0] == scores[1]
    assert all(scores[0])


def test_a_program_in_its_own_folder_runs_and_the_signal_that_ended_it_is_named(tmp_path):
    """A command of `trackers.toml`: it sees its folder, and its answer comes through."""
    own, log = tmp_path / "own", tmp_path / "run" / "x@y" / "stderr.log"
    log.parent.mkdir(parents=True)
    own.mkdir()
    program = own / "program"
    program.write_text("#!/bin/sh\nls / >&2; cat notes >&2; exit 7\n")
    program.chmod(0o755)
    (own / "notes").write_text("its own notes\n")
    with pytest.raises(TrialEnded, match=r"exited with code 7 \(its own notes\)"):
        TrackerProcess(Launch("program", (str(program),), own), STREAM, {}, Limits(sandbox=True), log).__enter__()
    assert "home" not in log.read_text().split()
    program.write_text("#!/bin/sh\nkill -SEGV $$\n")
    with pytest.raises(TrialEnded, match="killed by SIGSEGV"):
        TrackerProcess(Launch("program", (str(program),), own), STREAM, {}, Limits(sandbox=True), log).__enter__()


def test_the_code_of_another_environment_is_seen(tmp_path):
    environment, project = tmp_path / "env", tmp_path / "my tracker"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(environment)], check=True)
    info = next(environment.glob("lib/python*/site-packages")) / "my_tracker-1.0.dist-info"
    info.mkdir()
    origin = {"url": project.as_uri(), "dir_info": {"editable": True}}
    (info / "direct_url.json").write_text(json.dumps(origin))
    folders = code_folders(str(environment / "bin" / "python"), tmp_path / "cwd", {})
    assert {environment, project, tmp_path / "cwd"} <= set(folders)
    (info / "direct_url.json").write_text("[" * 10_000)
    assert project not in code_folders(str(environment / "bin" / "python"), None, {})


def test_without_bubblewrap_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setenv("PATH", os.fspath(Path(sys.executable).parent))
    monkeypatch.setattr(sandbox, "_problem", sandbox._problem.__wrapped__)  # which remembers its answer
    with pytest.raises(ConfigurationError, match="--sandbox: bubblewrap is not installed: install"):
        check_sandbox()


def test_a_plugin_beside_gridtrack_is_named_by_a_notice(settings, burglar, monkeypatch):
    """Its package is imported by no process of gridtrack, but `.pth` files run in every interpreter."""
    confined = settings("burglar", "persistence", limits=Limits(sandbox=True))
    (notice,) = (one for one in map(str, resolve(confined).notices) if "--sandbox" in one)
    assert notice.startswith("burglar: --sandbox confines its process, but its package is installed beside gridtrack")
