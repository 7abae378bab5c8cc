"""A run in a store: the first content of the local folder, and when it is uploaded, kept and removed."""

from __future__ import annotations

import pytest

from gridtrack.common.errors import StoreError
from gridtrack.evaluation.runs.result_files import RunError
from gridtrack.evaluation.runs.stored_run import stored_run

URL = "memory://bucket/runs/hall"


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "home"))
    return tmp_path / "home"


@pytest.fixture
def store(bucket):
    bucket.pipe("/bucket/other", b"1")
    return bucket


@pytest.fixture
def notes():
    return []


def begun(notes, *, resume=False, again="the command --resume"):
    return stored_run(URL, resume=resume, again=again, note=notes.append)


def make_run(folder, content):
    (folder / "run.json").write_text(content)


def test_a_run_that_was_interrupted_is_uploaded_and_continued(store, home, notes):
    with begun(notes) as folder:
        assert folder.name == "hall"
        make_run(folder, "interrupted")
        (folder / ".engine").mkdir()
    assert store.find("/bucket/runs") == ["/bucket/runs/hall/run.json"]
    assert not list(home.rglob("hall"))
    with begun(notes, resume=True) as folder:
        assert (folder / "run.json").read_text() == "interrupted"
        make_run(folder, "complete")
    assert store.cat("/bucket/runs/hall/run.json") == b"complete"
    assert notes == [f"{URL}: fetching 1 of 1 files, 0.0 MB"]


def test_a_run_in_the_store_is_not_begun_anew(store, home, notes):
    store.pipe("/bucket/runs/hall/run.json", b"a run")
    with pytest.raises(RunError, match=f"{URL} holds a run already: continue it with --resume"), begun(notes):
        pass
    assert store.cat("/bucket/runs/hall/run.json") == b"a run"
    assert not list(home.rglob("hall"))


def crash(folders, notes, **how):
    with begun(notes, **how) as folder:
        folders.append(folder)
        make_run(folder, "running")
        raise KeyboardInterrupt


def test_leftovers_of_an_error_are_kept_and_named_in_one_line(store, home, notes):
    folders = []
    with pytest.raises(KeyboardInterrupt):
        crash(folders, notes)
    (line,) = notes
    assert line.startswith(f"{folders[0]} keeps the run")
    assert "run `the command --resume`" in line
    with begun(notes, resume=True) as again:
        assert (again / "run.json").read_text() == "running"
    assert store.cat("/bucket/runs/hall/run.json") == b"running"


def test_a_run_that_no_command_continues_is_to_be_copied(store, home, notes):
    with pytest.raises(KeyboardInterrupt):
        crash([], notes, again=None)
    assert notes[-1].endswith(f"{URL} does not have in this state: copy it")


def test_a_fetched_run_to_which_nothing_was_added_is_not_kept(store, home, notes):
    store.pipe("/bucket/runs/hall/run.json", b"a run")
    with pytest.raises(RunError, match="refused"), begun(notes, resume=True):
        raise RunError("refused")
    assert not list(home.rglob("hall"))


def made_beside_another(store, folders, notes):
    with begun(notes) as folder:
        folders.append(folder)
        make_run(folder, "mine")
        store.pipe("/bucket/runs/hall/run.json", b"the other's")


def test_a_run_that_another_put_there_meanwhile_is_not_replaced(store, notes):
    folders = []
    with pytest.raises(StoreError, match="another run was uploaded since this one began"):
        made_beside_another(store, folders, notes)
    with pytest.raises(StoreError, match="is not replaced: copy"), begun(notes, resume=True):
        pass
    assert store.cat("/bucket/runs/hall/run.json") == b"the other's"
    assert (folders[0] / "run.json").read_text() == "mine"


def test_two_comparisons_do_not_make_one_run_at_a_time(store, notes):
    with begun(notes) as folder:
        make_run(folder, "first")
        with pytest.raises(RunError, match="in use by another run"), begun(notes, resume=True):
            pass
    assert store.cat("/bucket/runs/hall/run.json") == b"first"
