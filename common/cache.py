"""Files that can be made again, kept in the user's cache folder: found by what they were made from, each with its hash.

An entry is a file of its own, moved into place when it is complete, so that several processes may use one cache. Users
get copies and never the entry itself: who writes to a copy, or links to it, changes nothing here.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO

from gridtrack.common.files import user_cache_folder

BLOCK_BYTES = 1 << 20
DIGEST_BYTES = hashlib.sha256().digest_size


class FileCache:
    """The folder `name` of the user's cache, with about `max_bytes` at most. It may be emptied at any time."""

    def __init__(self, name: str, max_bytes: int, report: Callable[[str], None]) -> None:
        """`report` is told of damaged entries, and of a folder that cannot be used: the files are then made anew."""
        self.folder = user_cache_folder() / name
        self._max_bytes, self._report = max_bytes, report
        self._usable = True

    def fetch(self, key: Mapping[str, Any], target: Path, make: Callable[[Path], object]) -> Path:
        """Let `target` be the file of `key`, which `make` writes to the path that it is given; returns `target`.

        `key` (JSON) is everything that the content depends on, the version of its format too. Raises what `make`
        raises, and OSError where `target` cannot be written.
        """
        entry = self.folder / hashlib.sha256(json.dumps(dict(key), sort_keys=True).encode()).hexdigest()
        target.unlink(missing_ok=True)  # it may be a link to another file, which stays as it is
        if self._usable and self._copied(entry, target):
            return target
        room = self._room() if self._usable else None
        if room is None:
            make(target)
            return target
        with room as folder:
            made = Path(folder) / target.name
            make(made)
            shutil.copyfile(made, target)
            self._keep(made, entry)
        return target

    def trim(self) -> None:
        """Delete the entries used longest ago until the others have at most `max_bytes` together."""
        kept = 0
        with suppress(OSError):
            found = [(path, path.stat()) for path in self.folder.iterdir() if path.is_file()]
            for path, status in sorted(found, key=lambda entry: entry[1].st_mtime_ns, reverse=True):
                kept += status.st_size
                if kept > self._max_bytes:
                    path.unlink(missing_ok=True)

    def _copied(self, entry: Path, target: Path) -> bool:
        """Whether `target` is now the content of `entry`; not without one, nor where it does not end in its hash."""
        try:
            file = entry.open("rb")
        except FileNotFoundError:
            return False
        except OSError as error:
            self._cannot(error)
            return False
        with file, target.open("xb") as copy:
            sound = _copy_checked(file, copy)
        if not sound:
            target.unlink()
            self._report(f"{entry}: damaged; made again")
            return False
        with suppress(OSError):
            os.utime(entry)
        return True

    def _room(self) -> TemporaryDirectory[str] | None:
        """A folder in which an entry is made; None where there can be none."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            return TemporaryDirectory(dir=self.folder, prefix="making-")
        except OSError as error:
            self._cannot(error)
            return None

    def _keep(self, made: Path, entry: Path) -> None:
        """Move the complete file `made` to `entry`."""
        try:
            with made.open("r+b") as file:
                digest = hashlib.file_digest(file, "sha256").digest()
                file.write(digest)
            made.replace(entry)
        except OSError as error:
            self._cannot(error)

    def _cannot(self, error: OSError) -> None:
        self._usable = False
        self._report(
            f"{self.folder}: cannot be used ({error.strerror}), so nothing is kept for the next time; set"
            " XDG_CACHE_HOME to a folder with room"
        )


def _copy_checked(file: BinaryIO, copy: BinaryIO) -> bool:
    """Copy `file` but for the digest at its end; whether that is the digest of the rest."""
    left, digest = file.seek(0, os.SEEK_END) - DIGEST_BYTES, hashlib.sha256()
    file.seek(0)
    while left > 0 and (block := file.read(min(BLOCK_BYTES, left))):
        digest.update(block)
        copy.write(block)
        left -= len(block)
    return left == 0 and file.read() == digest.digest()
