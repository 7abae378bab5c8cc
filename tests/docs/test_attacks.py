"""The tests and commands that docs/attacks.md names exist."""

from __future__ import annotations

import re
from importlib.util import find_spec

from docs.pages import ROOT

ROW = re.compile(r"^\| .+ \| (.+) \| (.*)\|$", re.MULTILINE)
SHOWN = re.compile(r"`(.+?)`")


def _exists(shown: str) -> bool:
    path, _, name = shown.partition("::")
    if name:
        file = ROOT / "tests" / path
        return file.is_file() and f"def {name}(" in file.read_text("utf-8")
    return find_spec(shown.removeprefix("python -m ")) is not None


def test_every_attack_names_a_test_or_a_command_that_exists_unless_it_is_a_limit() -> None:
    rows = [row for row in ROW.findall((ROOT / "docs/attacks.md").read_text("utf-8")) if row[0] != "result"]
    assert len(rows) >= 30
    assert [row for row in rows if not SHOWN.findall(row[1]) and "*limit*" not in row[0]] == []
    assert [shown for _, shown_by in rows for shown in SHOWN.findall(shown_by) if not _exists(shown)] == []


def test_a_test_and_a_command_that_do_not_exist_are_found() -> None:
    assert not _exists("common/test_files.py::test_absent")
    assert not _exists("python -m studies.absent")
