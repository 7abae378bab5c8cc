"""The cache of files: made once, checked at every use, independent of its copies, and bounded."""

from __future__ import annotations

import os
import shutil
import threading

import pytest

from gridtrack.common.cache import FileCache


@pytest.fixture
def notes():
    return []


@pytest.fixture
def cache(tmp_path, monkeypatch, notes):
    monkeypatch.setattr("gridtrack.common.cache.user_cache_folder", lambda: tmp_path / "cache")
    return FileCache("things", 1 << 20, notes.append)


def fetched(cache, key, target, content=b"content"):
    """The content of the target, and whether this call made it."""
    made = []

    def make(path):
        made.append(path)
        path.write_bytes(content)

    return cache.fetch(key, target, make).read_bytes(), bool(made)


def entry_of(cache):
    (entry,) = cache.folder.iterdir()
    return entry


def test_a_file_is_made_once_for_each_key(cache, tmp_path, notes):
    assert fetched(cache, {"a": 1, "b": 2}, tmp_path / "one") == (b"content", True)
    assert fetched(cache, {"b": 2, "a": 1}, tmp_path / "two") == (b"content", False)
    assert fetched(cache, {"a": 1, "b": 3}, tmp_path / "three", b"") == (b"", True)
    assert fetched(cache, {"a": 1, "b": 3}, tmp_path / "four") == (b"", False)
    assert notes == []


@pytest.mark.parametrize(
    "damage", [lambda b: b[:-1], lambda b: b"x" + b[1:], lambda b: b[:5], lambda b: b"", lambda b: b + b"x"]
)
def test_a_damaged_entry_is_reported_and_made_again(damage, cache, tmp_path, notes):
    fetched(cache, {}, tmp_path / "one")
    entry = entry_of(cache)
    entry.write_bytes(damage(entry.read_bytes()))
    assert fetched(cache, {}, tmp_path / "two", b"anew") == (b"anew", True)
    assert notes == [f"{entry}: damaged; made again"]
    assert fetched(cache, {}, tmp_path / "three") == (b"anew", False)


def test_a_changed_copy_does_not_change_the_entry(cache, tmp_path, notes):
    for target in (tmp_path / "one", tmp_path / "two"):
        fetched(cache, {}, target)
        with target.open("r+b") as file:
            file.write(b"damage!")
        os.truncate(target, 3)
        target.unlink()
        target.symlink_to(entry_of(cache))
        assert fetched(cache, {}, target) == (b"content", False)
        assert not target.is_symlink()
    assert notes == []


def test_two_threads_may_make_one_entry_at_once(cache, tmp_path, notes):
    both, results = threading.Barrier(2, timeout=20), {}

    def use(name):
        def make(path):
            both.wait()
            path.write_bytes(name.encode())

        results[name] = cache.fetch({}, tmp_path / name, make).read_bytes()

    threads = [threading.Thread(target=use, args=(name,)) for name in ("one", "two")]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert results == {"one": b"one", "two": b"two"}
    content, made = fetched(cache, {}, tmp_path / "three")
    assert (content in (b"one", b"two"), made, notes) == (True, False, [])


def test_nothing_stays_of_an_interrupted_entry(cache, tmp_path):
    def make(path):
        path.write_bytes(b"half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        cache.fetch({}, tmp_path / "one", make)
    assert not cache.folder.exists()
    assert not (tmp_path / "one").exists()


def test_the_user_may_empty_the_cache_while_a_file_is_made(cache, tmp_path, notes):
    fetched(cache, {"n": 1}, tmp_path / "one")

    def make(path):
        shutil.rmtree(cache.folder)
        path.write_bytes(b"content")

    assert cache.fetch({"n": 2}, tmp_path / "two", make).read_bytes() == b"content"
    assert fetched(cache, {"n": 2}, tmp_path / "three") == (b"content", False)
    assert notes == []


def test_without_a_folder_nothing_is_cached_with_one_note(cache, tmp_path, notes):
    cache.folder.parent.write_text("a file where the folder should be")
    for _ in range(2):
        assert fetched(cache, {}, tmp_path / "one") == (b"content", True)
    assert len(notes) == 1
    assert "cannot be used (Not a directory), so nothing is cached; set XDG_CACHE_HOME" in notes[0]


def test_entries_used_longest_ago_are_deleted_beyond_the_limit(cache, tmp_path):
    for number in range(4):
        fetched(cache, {"n": number}, tmp_path / "one", bytes(400_000))
        for entry in cache.folder.iterdir():  # an hour passes
            os.utime(entry, ns=(0, entry.stat().st_mtime_ns - 3_600_000_000_000))
    fetched(cache, {"n": 1}, tmp_path / "one")
    cache.trim()
    assert [fetched(cache, {"n": number}, tmp_path / "one")[1] for number in range(4)] == [True, False, True, False]
