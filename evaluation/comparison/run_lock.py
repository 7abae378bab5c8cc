"""One run at a time in a folder: a lock that the system lets go of when its process ends, however it ends."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from gridtrack.evaluation.scoring.record import RunError

LOCK = ".lock"
NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)
"""What a file system answers that keeps no locks, as some of those shared by many machines: a run goes on without."""


@contextmanager
def run_lock(folder: Path) -> Iterator[None]:
    """Make `folder` where there is none, and keep every other run out of it.

    The lock is on a file that stays; none of the processes started meanwhile inherits it, so it never outlives this
    one. Raises RunError where another run has it, or where the folder cannot be made.
    """
    if folder.is_file():
        raise RunError(f"{folder}: a file, and a run is kept in a folder: name one with --out")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RunError(f"{folder}: cannot be made ({error.strerror}): name another folder with --out") from None
    with (folder / LOCK).open("a+", encoding="utf-8") as file:
        _lock(file, folder)
        file.truncate(0)
        file.write(f"{os.getpid()}\n")
        file.flush()
        yield


def _lock(file: TextIO, folder: Path) -> None:
    import fcntl  # POSIX only, as the limits of a tracker's process are: what only reads runs does without

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        file.seek(0)
        raise RunError(
            f"{folder}: a run is still going on in it (process {file.read(20).strip() or 'unknown'}): wait until it has"
            " ended or stop it, or name another folder with --out"
        ) from None
    except OSError as error:
        if error.errno not in NO_LOCKS:
            raise
