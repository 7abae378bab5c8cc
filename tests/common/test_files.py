"""Files are replaced whole or not changed, and read within a bound; names cannot leave their folder."""

from __future__ import annotations

import errno
import hashlib
import os
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gridtrack.common.errors import GridtrackError
from gridtrack.common.files import (
    MAX_NAME_BYTES,
    atomic_write,
    check_path,
    is_label,
    is_name,
    name_from,
    open_new,
    open_regular,
    read_bounded,
    read_json,
    refuse_links,
    sha256_of,
    user_cache_folder,
    user_data_folder,
    write_text,
)


class FileError(GridtrackError):
    pass


def write_and_fail(path, text, **options):
    with atomic_write(path, **options) as file:
        file.write(text)
        raise ZeroDivisionError


def test_a_file_is_replaced_when_the_block_ends(tmp_path):
    path = tmp_path / "a.bin"
    path.write_bytes(b"old")
    with atomic_write(path) as file:
        file.write(b"new")
        assert path.read_bytes() == b"old"
    assert path.read_bytes() == b"new"
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_is_not_changed_when_the_block_raises(tmp_path):
    path = tmp_path / "a.bin"
    path.write_bytes(b"old")
    with pytest.raises(ZeroDivisionError):
        write_and_fail(path, b"half of the new")
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_the_content_written_before_an_error_can_be_kept(tmp_path):
    path = tmp_path / "a.bin"
    with pytest.raises(ZeroDivisionError):
        write_and_fail(path, b"scored so far", keep_on_error=True)
    assert path.read_bytes() == b"scored so far"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT])
def test_the_error_of_a_full_disk_names_the_file_and_the_remedy(tmp_path, number):
    with pytest.raises(OSError, match="free space there") as full, atomic_write(tmp_path / "a.json"):
        raise OSError(number, os.strerror(number))
    assert (full.value.errno, full.value.filename) == (number, str(tmp_path / "a.json"))
    assert list(tmp_path.iterdir()) == []


def test_a_file_above_the_bound_is_refused(tmp_path):
    path = tmp_path / "a.bin"
    path.write_bytes(b"12345")
    assert read_bounded(path, 5, FileError) == b"12345"
    with pytest.raises(FileError, match="larger than 4 bytes"):
        read_bounded(path, 4, FileError)


def test_a_missing_file_is_left_to_the_caller_and_a_folder_is_refused(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_bounded(tmp_path / "missing", 5, FileError)
    with pytest.raises(FileError, match="cannot be read"):
        read_bounded(tmp_path, 5, FileError)


@pytest.mark.parametrize("text", ["[1, 2]", "{", '"text"', "[" * 100_000, "\x00"])
def test_only_a_json_object_is_read(tmp_path, text):
    path = tmp_path / "a.json"
    write_text(path, text)
    with pytest.raises(FileError, match=r"a\.json: (not JSON|expected one JSON object)"):
        read_json(path, 1 << 20, FileError)


def test_text_is_utf8(tmp_path):
    path = tmp_path / "a.json"
    write_text(path, '{"place": "São Paulo"}')
    assert read_json(path, 100, FileError) == {"place": "São Paulo"}


def test_the_hash_of_a_file(tmp_path):
    path = tmp_path / "a.bin"
    path.write_bytes(b"x" * 3_000_000)
    assert sha256_of(path) == hashlib.sha256(b"x" * 3_000_000).hexdigest()


def test_the_folders_of_a_user_follow_the_environment(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert user_data_folder() == tmp_path / "data" / "gridtrack"
    assert user_cache_folder() == tmp_path / "cache" / "gridtrack"


@pytest.mark.parametrize("name", ["test", "leave-one-out", "first half", "exp[1]", "a*b?", "café", "東京", "x" * 160])
def test_ordinary_names_are_allowed(name: str) -> None:
    assert is_name(name)


@pytest.mark.parametrize(
    "name", ["", ".", "..", "../x", "a/b", "a\\b", "/etc", ".hidden", " x", "a\nb", "a\x00b", "a\udce9", "é" * 81]
)
def test_names_that_are_no_part_of_a_path_are_refused(name: str) -> None:
    assert not is_name(name)


@pytest.mark.parametrize(
    ("file", "name"),
    [("run.v1.2.db3", "run.v1.2"), ("run.v1.3.db3", "run.v1.3"), ("fr079.clf.gz", "fr079"), ("A.CLF", "A"), ("a", "a")],
)
def test_the_name_of_a_site_is_the_file_without_its_ending(file: str, name: str, tmp_path: Path) -> None:
    assert name_from(Path(file)) == name
    (tmp_path / "run.v1").mkdir()
    assert name_from(tmp_path / "run.v1") == "run.v1"


@settings(max_examples=50)
@given(st.text(max_size=60))
def test_a_name_never_leaves_its_folder(name: str) -> None:
    if is_name(name):
        assert (Path("/out") / name).parts == ("/", "out", name)
    assert is_name(name_from(Path(name)))
    assert is_label("a")
    assert not is_label("a" * (MAX_NAME_BYTES + 1))


def test_a_file_is_written_beside_a_link_that_waits_for_it(tmp_path):
    """A stranger's folder may have links at the name itself, and at every name that can be foreseen."""
    mine = tmp_path / "mine"
    mine.write_text("precious")
    for name in ("a.json", "a.json.partial"):
        (tmp_path / name).symlink_to(mine)
    write_text(tmp_path / "a.json", "{}")
    assert mine.read_text() == "precious"
    assert (tmp_path / "a.json").read_text() == "{}"
    assert not (tmp_path / "a.json").is_symlink()


@pytest.fixture(params=["link", "pipe", "folder"])
def foreign(request, tmp_path):
    """A folder with a link to a file, a pipe, or a link to a folder, in a folder in it; and the name of that."""
    folder, target = tmp_path / "run", tmp_path / "mine"
    entry = folder / "trial" / "outcome.json"
    entry.parent.mkdir(parents=True)
    if request.param == "pipe":
        os.mkfifo(entry)
    elif request.param == "link":
        target.write_text("{}")
        entry.symlink_to(target)
    else:
        target.mkdir()
        entry.symlink_to(target)
    return folder, entry


def test_a_folder_with_a_link_or_a_pipe_is_refused(foreign):
    folder, entry = foreign
    with pytest.raises(FileError, match=f"^{entry}: (a link|a pipe, a socket or a device); .*: remove it$"):
        refuse_links(folder, FileError)


def test_a_folder_of_files_and_folders_is_not_refused(tmp_path):
    (tmp_path / "run" / "trial").mkdir(parents=True)
    (tmp_path / "run" / "trial" / "outcome.json").write_text("{}")
    refuse_links(tmp_path, FileError)


def test_a_thousand_folders_in_each_other_are_refused_in_one_line(tmp_path, monkeypatch):
    """Deeper than Python may recurse; only relative paths reach them."""
    monkeypatch.chdir(tmp_path)
    for _ in range(1000):
        Path("d").mkdir()
        os.chdir("d")
    with pytest.raises(FileError, match="more than 32 folders in each other: remove it"):
        refuse_links(tmp_path, FileError)
    for _ in range(1000):  # pytest would leave them
        os.chdir("..")
        Path("d").rmdir()


@pytest.mark.parametrize("link", [os.symlink, os.link], ids=["soft", "hard"])
def test_a_new_file_is_not_written_into_a_file_with_another_name(tmp_path, link):
    """The log of a tracker, in a folder that was received with a link of this name."""
    mine, log = tmp_path / "mine", tmp_path / "stderr.log"
    mine.write_text("precious")
    link(mine, log)
    with open_new(log) as file:
        file.write(b"found")
    assert (mine.read_text(), log.read_text()) == ("precious", "found")


def test_a_pipe_is_no_file_to_read(tmp_path):
    """Without a writer it would block for ever."""
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OSError, match="a pipe, a socket or a device"):
        open_regular(tmp_path / "pipe")
    with pytest.raises(FileError, match=r"pipe: cannot be read \(a pipe, a socket or a device\)"):
        read_bounded(tmp_path / "pipe", 100, FileError)


@pytest.mark.parametrize("name", ["a\nb", "\x1b[2Jrun", "run\x7f"])
def test_a_path_with_control_characters_is_refused(name):
    with pytest.raises(FileError, match="this path has control characters: rename it") as refused:
        check_path(Path("runs", name), FileError)
    assert str(refused.value).isprintable()
    check_path(Path("runs", "Überwachung 東京"), FileError)
