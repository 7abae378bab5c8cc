"""Errors that a user can cause: the command line prints one line and exits with code 2, or 3 where nothing can be
measured."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

MAX_NAMES = 20
"""Limit of the names listed in one error line."""
MAX_NAME_CHARS = 200
"""Characters of an unknown name that are compared with the known names."""
INTERRUPTED_EXIT_CODE = 130
"""Exit code of a process after an interrupt, by the convention of shells for Ctrl-C."""
MAX_LINE_CHARS = 2000
"""Limit of a line that may quote untrusted input."""
CUT_MARK = " ... "


class GridtrackError(Exception):
    """Base of all errors that gridtrack raises on purpose. The message names the place, the problem and the remedy.

    As text it is one printable line of at most MAX_LINE_CHARS characters, even if it quotes untrusted input.
    """

    exit_code = 2

    def __str__(self) -> str:
        return bounded_line(super().__str__())


class ConfigurationError(GridtrackError):
    """An invalid option, name or value."""


class RecordingError(GridtrackError):
    """A recording that cannot be read completely."""


class NothingMeasuredError(RecordingError):
    """A recording without a measured range: nothing can be scored or learned."""

    exit_code = 3


class WeightsError(GridtrackError):
    """Learned weights that are missing, damaged, or for another grid or period."""


class StoreError(GridtrackError):
    """A file or folder at a URL that cannot be fetched, listed or uploaded."""


class PluginError(GridtrackError):
    """A plugin (tracker, recording format) that is unknown or cannot be loaded."""


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """The end of an error line: the known name closest to `name`, or all known names if none is close."""
    names = sorted(known)
    near = difflib.get_close_matches(name[:MAX_NAME_CHARS], names, n=1, cutoff=0.6)
    if near:
        return f"did you mean '{near[0]}'?"
    more = f" and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else ""
    return "known: " + ", ".join(names[:MAX_NAMES]) + more if names else "there are none"


def printable(line: str) -> str:
    """`line` with a space for each unprintable character, such as the control codes of a terminal."""
    return "".join(character if character.isprintable() else " " for character in line)


def printable_lines(text: str) -> str:
    """`text` with each of its lines `printable`."""
    return "\n".join(map(printable, text.split("\n")))


def bounded_line(text: str) -> str:
    """`text` as one printable line of at most MAX_LINE_CHARS characters, cut in the middle: the remedy stands last."""
    if len(text) > MAX_LINE_CHARS:
        tail = MAX_LINE_CHARS // 4
        text = text[: MAX_LINE_CHARS - tail - len(CUT_MARK)] + CUT_MARK + text[-tail:]
    return printable(text)


def one_line(text: str, max_chars: int) -> str:
    """`text` as one printable line of at most `max_chars` characters, with single spaces."""
    return " ".join(printable(text[:max_chars]).split())
