"""Errors that a user can cause; the command line turns each into one line and exit code 2."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

MAX_NAMES = 20
"""So many names are listed in one error line."""


class GridtrackError(Exception):
    """Root of every error gridtrack raises on purpose: the message says what is wrong, where, and what to do."""


class ConfigurationError(GridtrackError):
    """An option, name or value that does not fit."""


class RecordingError(GridtrackError):
    """A recording that cannot be read, or not in full."""


class WeightsError(GridtrackError):
    """Learned weights that are missing, damaged, or made for another grid or period."""


class PluginError(GridtrackError):
    """A tracker plugin that is unknown, or that cannot be loaded."""


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """A suggestion to end an error line with: the nearest known name, or those there are when none is near."""
    names = sorted(known)
    near = difflib.get_close_matches(name, names, n=1, cutoff=0.6)
    if near:
        return f"did you mean '{near[0]}'?"
    more = f" and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else ""
    return "known: " + ", ".join(names[:MAX_NAMES]) + more if names else "there are none"


def printable(line: str) -> str:
    """`line` with a space in place of each character that cannot be printed, such as a terminal's control codes."""
    return "".join(character if character.isprintable() else " " for character in line)


def one_line(text: str, max_chars: int) -> str:
    """`text` as one printable line of at most `max_chars` characters, its runs of spaces made one."""
    return " ".join(printable(text[:max_chars]).split())
