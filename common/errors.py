"""Errors that a user can cause, printed by the command line as one line with exit code 2; parts of their messages."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

MAX_NAMES = 20
"""Limit of the names listed in one error line."""
MAX_NAME_CHARS = 200
"""So much of an unknown name is compared with the known ones."""
INTERRUPTED_EXIT_CODE = 130
"""Exit code of a process after Ctrl-C, as of a shell."""
MAX_LINE_CHARS = 2000
"""Limit of a line that may quote untrusted input."""
CUT_MARK = " ... "


class GridtrackError(Exception):
    """Root of every error gridtrack raises on purpose: the message says what is wrong, where, and what to do.

    As text it is one printable line of at most MAX_LINE_CHARS characters, whatever untrusted input it quotes.
    """

    def __str__(self) -> str:
        return bounded_line(super().__str__())


class ConfigurationError(GridtrackError):
    """An option, name or value that is not valid."""


class RecordingError(GridtrackError):
    """A recording that cannot be read, or only in part."""


class WeightsError(GridtrackError):
    """Learned weights that are missing, damaged, or made for another grid or period."""


class StoreError(GridtrackError):
    """A file or folder that a URL names, and that cannot be fetched, listed or uploaded."""


class PluginError(GridtrackError):
    """A plugin (tracker, recording format) that is unknown, or that cannot be loaded."""


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """The end of an error line: the known name closest to `name`, or the known names where none is close."""
    names = sorted(known)
    near = difflib.get_close_matches(name[:MAX_NAME_CHARS], names, n=1, cutoff=0.6)
    if near:
        return f"did you mean '{near[0]}'?"
    more = f" and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else ""
    return "known: " + ", ".join(names[:MAX_NAMES]) + more if names else "there are none"


def printable(line: str) -> str:
    """`line` with a space in place of each character that cannot be printed, such as a terminal's control codes."""
    return "".join(character if character.isprintable() else " " for character in line)


def printable_lines(text: str) -> str:
    """`text` with each of its lines `printable`."""
    return "\n".join(map(printable, text.split("\n")))


def bounded_line(text: str) -> str:
    """`text` as one printable line of at most MAX_LINE_CHARS characters, cut in the middle: the remedy is last."""
    if len(text) > MAX_LINE_CHARS:
        tail = MAX_LINE_CHARS // 4
        text = text[: MAX_LINE_CHARS - tail - len(CUT_MARK)] + CUT_MARK + text[-tail:]
    return printable(text)


def one_line(text: str, max_chars: int) -> str:
    """`text` as one printable line of at most `max_chars` characters, its runs of spaces made one."""
    return " ".join(printable(text[:max_chars]).split())
