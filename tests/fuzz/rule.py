"""The rule for every reader: a result, a part of it with a warning, or a GridtrackError of one line."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from fuzz import recording_readers, result_readers, wire_readers
from fuzz.damage import Choices
from fuzz.reader import Reader
from gridtrack.common.errors import MAX_LINE_CHARS, GridtrackError

READERS: dict[str, Reader] = recording_readers.READERS | wire_readers.READERS | result_readers.READERS
"""All readers of untrusted input, by name."""


@dataclass(frozen=True)
class Finding:
    """The outcome of one damaged input: a result, or a refusal; `line` in a few words."""

    refused: bool
    line: str


class Inputs:
    """The valid inputs of all readers, made when they are first used, and damaged copies of them."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def check(self, name: str, choices: Choices, keep: Path | None = None) -> Finding:
        """Damage the input of reader `name` and read it. Raises whatever breaks the rule; `keep` has the input then."""
        with TemporaryDirectory(dir=self._folder) as room:
            copy = Path(room, "input")
            shutil.copytree(self._valid(name), copy)
            READERS[name].damage(choices, copy)
            try:
                return finding(name, copy)
            except BaseException:
                if keep is not None:
                    shutil.copytree(copy, keep, dirs_exist_ok=True)
                raise

    def _valid(self, name: str) -> Path:
        folder = self._folder / name
        if not folder.exists():
            folder.mkdir(parents=True)
            READERS[name].make(folder)
        return folder


def finding(name: str, folder: Path) -> Finding:
    """Read the input in `folder`. Raises AssertionError for an error that is not one printable line."""
    try:
        line = READERS[name].read(folder)
        refused = False
    except GridtrackError as error:
        line, refused = str(error), True
    assert line, "an empty line"
    assert line.isprintable(), f"not printable: {line!r}"
    assert len(line) <= MAX_LINE_CHARS, f"{len(line)} characters"
    return Finding(refused, line)
