"""Keeps the paths of recordings out of what /proc shows to a tracker's process; docs/wire.md says what remains."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Iterable
from pathlib import Path

from gridtrack.evaluation.hosting.orphans import adopt_orphans
from gridtrack.evaluation.hosting.supervisor import make_unreadable

ARG_START, ARG_END = 45, 46
"""Positions in /proc/self/stat, after the name in parentheses, of the command line's addresses (proc(5), 48 and 49)."""


def shield_host(title: str) -> None:
    """Replace the command line of this process by `title`, and make its /proc entries unreadable for other processes.

    It also becomes the parent of what trackers leave behind. On systems other than Linux nothing changes.
    """
    if sys.platform != "linux":
        return
    fields = Path("/proc/self/stat").read_text().rpartition(")")[2].split()
    start, size = int(fields[ARG_START]), int(fields[ARG_END]) - int(fields[ARG_START])
    if start and size > 1:
        # the last byte stays 0: else the kernel takes the environment for a part of the command line
        ctypes.memmove(start, title.encode()[: size - 1].ljust(size, b"\0"), size)
    make_unreadable()
    adopt_orphans()


def shielded_environment(recordings: Iterable[Path]) -> dict[str, str]:
    """The environment of this process without the variables that contain the path or the file name of a recording."""
    hidden = {text for path in recordings for text in (str(path.absolute()), str(path.resolve()), _file_name(path))}
    hidden.discard("")
    return {name: value for name, value in os.environ.items() if not any(text in value for text in hidden)}


def _file_name(path: Path) -> str:
    """The name of a file with a suffix; "" for a name without one, which may be an ordinary word."""
    return path.name if path.suffix else ""
