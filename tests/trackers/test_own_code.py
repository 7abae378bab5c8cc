"""The hash of a tracker's code changes with its files and with no others."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from gridtrack.trackers.registry import code_sha256
from gridtrack.trackers.selection import Launch


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A tracker's module with a helper beside it, and a library installed below."""
    library = tmp_path / "env" / "site-packages"
    library.mkdir(parents=True)
    (tmp_path / "own_tracker.py").write_text("import own_helper, own_library\nclass Own: pass\n")
    (tmp_path / "own_helper.py").write_text("GATE = 1\n")
    (library / "own_library.py").write_text("VERSION = 1\n")
    for folder in (tmp_path, library):
        monkeypatch.syspath_prepend(str(folder))
    yield tmp_path
    for name in ("own_tracker", "own_helper", "own_library"):
        sys.modules.pop(name, None)


def test_an_edit_of_the_tracker_or_of_what_lies_beside_it_changes_the_hash(own: Path) -> None:
    kind = importlib.import_module("own_tracker").Own
    first = code_sha256(kind)
    assert len(first) == 64
    assert code_sha256(kind) == first
    (own / "env" / "site-packages" / "own_library.py").write_text("VERSION = 2\n")
    assert code_sha256(kind) == first
    (own / "own_helper.py").write_text("GATE = 2\n")
    second = code_sha256(kind)
    (own / "own_tracker.py").write_text("class Own: gate = 2\n")
    assert len({first, second, code_sha256(kind)}) == 3


def test_a_program_is_hashed_by_the_files_that_its_command_names(tmp_path: Path) -> None:
    (tmp_path / "tracker").write_text("one")
    first = Launch("own", ("./tracker", "--fast"), tmp_path).code_sha256()
    assert first == Launch("own", ("./tracker", "--slow"), tmp_path).code_sha256()
    (tmp_path / "tracker").write_text("two")
    assert first != Launch("own", ("./tracker", "--fast"), tmp_path).code_sha256()
    assert Launch("own", ("nowhere",), tmp_path).code_sha256() == ""
