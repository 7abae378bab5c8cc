"""The run lock: one run at a time in a folder. The system releases the lock when the process ends."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from gridtrack.evaluation.results.files import RunError

LOCK = ".lock"
UNSUPPORTED = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)
"""Errors of file systems without locks, such as some network file systems: the run continues without a lock."""


@contextmanager
def run_lock(folder: Path) -> Iterator[None]:
    """Create `folder` where there is none, and lock it against other runs.

    The lock file is never removed. Child processes do not inherit the lock, so it ends with this process. Raises
    RunError where another run has the lock, or where the folder cannot be created.
    """
    if folder.is_file():
        raise RunError(f"{folder}: is a file; a run needs a folder: name one with --out")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RunError(f"{folder}: cannot be created ({error.strerror}): name another folder with --out") from None
    with (folder / LOCK).open("a+", encoding="utf-8") as file:
        _lock(file, folder)
        file.truncate(0)
        file.write(f"{os.getpid()}\n")
        file.flush()
        yield


def _lock(file: TextIO, folder: Path) -> None:
    import fcntl  # POSIX only, like the limits of a tracker process; modules that only read runs do not need it

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        file.seek(0)
        raise RunError(
            f"{folder}: in use by another run (process {file.read(20).strip() or 'unknown'}): wait until it has ended,"
            " stop it, or name another folder with --out"
        ) from None
    except OSError as error:
        if error.errno not in UNSUPPORTED:
            raise
