"""Files and folders named by URLs: fetched whole, changed files only, no names outside the folder; and uploaded."""

from __future__ import annotations

import http.server
import threading
from functools import partial

import pytest

from gridtrack.common.errors import StoreError
from gridtrack.common.remote_files import fetched_file, fetched_folder, list_folder, upload_folder

FOLDER = "memory://bucket/weights"


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "gridtrack" / "weights"


@pytest.fixture
def store(bucket):
    """A store in memory with a folder of three files, one of them hidden."""
    bucket.pipe("/bucket/weights/kalman/hall.toml", b"card")
    bucket.pipe("/bucket/weights/kalman/hall.safetensors", b"arrays")
    bucket.pipe("/bucket/weights/.lock", b"1")
    return bucket


@pytest.fixture
def notes():
    return []


def content_of(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def lists(patched, store, path, size):
    """Lets the store list the file `path` alone."""
    listed = [{"name": path, "size": size, "type": "file"}]
    patched.setattr(type(store), "ls", lambda files, root, **options: listed)


CONTENT = {"kalman/hall.toml": b"card", "kalman/hall.safetensors": b"arrays"}


@pytest.mark.parametrize("url", [FOLDER, f"{FOLDER}/"])
def test_a_folder_is_fetched_once_under_its_own_name(url, store, notes, cache):
    first, again = (fetched_folder(url, "weights", notes.append) for _ in range(2))
    assert first == again
    assert first.name == "weights"
    assert first.is_relative_to(cache)
    assert content_of(first) == CONTENT
    assert notes == [f"{url}: fetching 2 of 2 files, 0.0 MB"]
    assert not list(cache.rglob(".*"))


def test_only_the_changed_files_of_a_folder_are_fetched_and_the_earlier_copy_stays(store, notes):
    first = fetched_folder(FOLDER, "weights", notes.append)
    store.pipe("/bucket/weights/kalman/hall.toml", b"another card")
    store.rm("/bucket/weights/kalman/hall.safetensors")
    second = fetched_folder(FOLDER, "weights", notes.append)
    assert content_of(second) == {"kalman/hall.toml": b"another card"}
    assert content_of(first) == CONTENT
    assert notes[1] == f"{FOLDER}: fetching 1 of 1 files, 0.0 MB"


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("/bucket/weights/../../escaped", "cannot be named here"),
        ("/bucket/weights//absolute", "cannot be named here"),
        ("/bucket/weights/a\\b", "cannot be named here"),
        ("/bucket/weights/a\nb", "cannot be named here"),
        ("/bucket/weights/" + "a" * 256, "cannot be named here"),
        ("/elsewhere/file", "is not a folder, or lists a file outside itself"),
        ("/bucket/weights", "is not a folder, or lists a file outside itself"),
    ],
)
def test_a_listed_name_outside_the_folder_is_refused_before_anything_is_fetched(
    path, message, store, notes, cache, monkeypatch
):
    with monkeypatch.context() as patched:
        lists(patched, store, path, 1)
        with pytest.raises(StoreError, match=message):
            fetched_folder(FOLDER, "weights", notes.append)
    assert (notes, cache.exists()) == ([], False)


def test_a_folder_that_is_listed_in_part_is_an_error(store, monkeypatch):
    listed = type(store).ls

    def ls(files, path, **options):
        if path.endswith("/kalman"):
            raise FileNotFoundError(path)
        return listed(files, path, **options)

    with monkeypatch.context() as patched:
        patched.setattr(type(store), "ls", ls)
        with pytest.raises(StoreError, match="cannot be listed"):
            list_folder(FOLDER)


@pytest.mark.parametrize("announced", [3, 9])
def test_a_file_of_another_size_than_announced_is_not_kept(store, notes, cache, monkeypatch, announced):
    path = "/bucket/weights/kalman/hall.toml"
    described = {"name": path, "size": announced, "type": "file"}
    with monkeypatch.context() as patched:
        patched.setattr(type(store), "info", lambda files, path: described)
        lists(patched, store, path, announced)
        for fetch, url in ((fetched_folder, FOLDER), (fetched_file, f"memory:/{path}")):
            with pytest.raises(StoreError, match=f"received 4 bytes instead of {announced}; try again"):
                fetch(url, "weights", notes.append)
    assert content_of(cache) == {}


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("memory://bucket/none", "there is no such folder, or no file in it|FileNotFoundError"),
        (
            "memory://bucket/%2e%2e",
            r"'\.\.' cannot be the name of a local copy",
        ),
        ("memory://bucket/%2e%2e%2fhall.mcap", r"'(hall\.mcap|\.\./hall\.mcap)' cannot be the name of a local copy"),
        ("nowhere://bucket/weights", "Protocol not known: nowhere"),
        ("http://user:secret@127.0.0.1/weights", "leave user and password out of the URL"),
        ("memory://simplecache::memory://bucket/weights", "a chain of file systems"),
        ("http://127.0.0.1:9/weights", "cannot be fetched"),
    ],
)
@pytest.mark.parametrize("fetch", [fetched_folder, fetched_file])
def test_what_cannot_be_fetched_is_one_line_of_error(fetch, url, message, store, notes):
    with pytest.raises(StoreError, match=message) as raised:
        fetch(url, "weights", notes.append)
    assert "secret" not in str(raised.value)


def test_a_folder_is_fetched_from_a_server_that_lists_it(tmp_path, notes):
    folder = tmp_path / "served" / "run" / "kalman@hall 2"
    folder.mkdir(parents=True)
    (folder / "outcome.json").write_bytes(b"{}")
    handler = partial(http.server.SimpleHTTPRequestHandler, directory=str(tmp_path / "served"))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        try:
            copy = fetched_folder(f"http://127.0.0.1:{server.server_port}/run", "runs", notes.append)
        finally:
            server.shutdown()
            thread.join()
    assert content_of(copy) == {"kalman@hall 2/outcome.json": b"{}"}


@pytest.fixture
def folder(tmp_path):
    made = tmp_path / "made"
    (made / "trial").mkdir(parents=True)
    (made / "run.json").write_bytes(b"{}")
    (made / "trial" / "scores").write_bytes(b"12")
    (made / ".lock").write_bytes(b"1")
    return made


@pytest.mark.parametrize("kind", ["memory", "file"])
def test_a_folder_is_uploaded_without_hidden_files(kind, folder, tmp_path, store):
    url = "memory://bucket/runs/hall" if kind == "memory" else f"file://{tmp_path}/store/runs/hall"
    assert list_folder(url) == {}
    upload_folder(folder, url, last="run.json")
    assert {name: stored.size for name, stored in list_folder(url).items()} == {"run.json": 2, "trial/scores": 2}


def test_an_incomplete_upload_is_an_error(folder, store, monkeypatch):
    arrived = []
    monkeypatch.setattr(type(store), "put_file", lambda files, local, path: arrived.append(path))
    with pytest.raises(StoreError, match=r"hall/(trial/scores|run\.json): the upload is not complete"):
        upload_folder(folder, "memory://bucket/runs/hall", last="run.json")
    assert arrived[-1].endswith("run.json")
