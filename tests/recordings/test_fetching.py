"""Recordings named by URLs: fetched once, whole or not at all, and read like files."""

from __future__ import annotations

import http.server
import os
import subprocess
import sys
import threading
from functools import partial
from pathlib import Path

import pytest

from gridtrack.common.errors import StoreError
from gridtrack.recordings import packaged_recording
from gridtrack.recordings.stretches import fetched

CONTENT = b"a recording" * 1000


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "gridtrack" / "recordings"


@pytest.fixture
def store(bucket):
    """A store in memory with a recording in it."""
    bucket.pipe("/bucket/hall.mcap", CONTENT)
    return bucket


@pytest.fixture
def notes():
    return []


@pytest.mark.parametrize("text", ["hall.mcap", "hall.mcap@30s-90s", "/data/a:b/hall.mcap", "s3:/bucket/hall.mcap"])
def test_what_is_no_url_stays_as_it_is(text, notes):
    assert fetched(text, notes.append) == text
    assert notes == []


def test_a_recording_is_fetched_once_under_its_own_name(store, notes, cache):
    first, again = (fetched("memory://bucket/hall.mcap@3s-9s", notes.append) for _ in range(2))
    assert first == again
    path, _, stretch = first.rpartition("@")
    assert stretch == "3s-9s"
    assert path.startswith(str(cache))
    assert path.endswith("/hall.mcap")
    assert Path(path).read_bytes() == CONTENT
    assert notes == ["memory://bucket/hall.mcap: fetching 0.0 MB"]
    assert [file.name for file in cache.rglob("*") if file.is_file()] == ["hall.mcap"]


def test_a_recording_that_has_changed_is_fetched_again(store, notes):
    first = fetched("memory://bucket/hall.mcap", notes.append)
    store.pipe("/bucket/hall.mcap", CONTENT + b"more")
    assert fetched("memory://bucket/hall.mcap", notes.append) != first
    assert len(notes) == 2


@pytest.mark.parametrize("sent", [CONTENT[:-1], CONTENT + b"more"])
def test_a_recording_that_comes_in_another_size_is_not_kept(store, notes, cache, monkeypatch, sent):
    store.pipe("/bucket/hall.mcap", sent)
    told = {"name": "/bucket/hall.mcap", "size": len(CONTENT), "type": "file"}
    with monkeypatch.context() as patched:
        patched.setattr(type(store), "info", lambda files, path: told)
        refuse_half(notes, sent)
    assert [file for file in cache.rglob("*") if file.is_file()] == []


def refuse_half(notes, sent):
    with pytest.raises(StoreError, match=f"received {len(sent)} bytes instead of {len(CONTENT)}; try again"):
        fetched("memory://bucket/hall.mcap", notes.append)


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("memory://bucket/none.mcap", r"none\.mcap: cannot be fetched \(FileNotFoundError"),
        ("memory://bucket/", "'' cannot be the name of a local copy"),
        ("memory://bucket/%2e%2e%2fhall.mcap", r"'\.\./hall\.mcap' cannot be the name"),
        ("nowhere://bucket/hall.mcap", "Protocol not known: nowhere"),
        ("http://user:secret@127.0.0.1/hall.mcap", "leave user and password out of the URL"),
        ("simplecache::memory://bucket/hall.mcap", "a chain of file systems"),
    ],
)
def test_what_cannot_be_fetched_is_told_in_one_line(url, message, store, notes):
    if url.startswith("simplecache"):
        url = f"memory://{url}"
    with pytest.raises(StoreError, match=message) as raised:
        fetched(url, notes.append)
    assert "\n" not in str(raised.value)
    assert "secret" not in str(raised.value)


@pytest.fixture
def server():
    """The folder of the recording that ships, on the loopback address."""
    folder = packaged_recording("leg_tracker").parent
    handler = partial(http.server.SimpleHTTPRequestHandler, directory=str(folder))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


def gridtrack(*words, folder):
    return subprocess.run(
        [sys.executable, "-m", "gridtrack.cli", *words],
        cwd=folder,
        env=dict(os.environ),
        capture_output=True,
        text=True,
        check=False,
    )


def test_commands_take_urls_where_they_take_recordings(server, tmp_path, cache):
    url = f"{server}/leg_tracker.mcap"
    shown = gridtrack("recording", "info", url, folder=tmp_path)
    assert (shown.returncode, "scans" in shown.stdout) == (0, True), shown.stderr
    row = ("--tracker", "persistence", "--horizon", "0.5s", "--every", "0.5s", "--out", "run")
    done = gridtrack("compare", f"{url}@90s-96s", *row, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "run" / "persistence@leg_tracker@90s-96s").is_dir()
    assert (shown.stderr + done.stderr).count("fetching") == 1
    missing = gridtrack("compare", f"{server}/none.mcap", *row, folder=tmp_path)
    assert missing.returncode == 2
    assert len(missing.stderr.splitlines()) == 1
