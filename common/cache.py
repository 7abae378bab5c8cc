"""A cache of files in the user's cache folder, by key, each with a checksum.

An entry is a file that is moved into place when it is complete, so several processes may use one cache. Users get
copies, never the entry itself: writing to a copy does not change the cache.
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
    """The folder `name` of the user's cache, of about `max_bytes` at most. The user may empty it at any time."""

    def __init__(self, name: str, max_bytes: int, report: Callable[[str], None]) -> None:
        """`report` receives a line for a damaged entry or an unusable folder; the files are then made again."""
        self.folder = user_cache_folder() / name
        self._max_bytes, self._report = max_bytes, report
        self._usable = True

    def fetch(self, key: Mapping[str, Any], target: Path, make: Callable[[Path], object]) -> Path:
        """Copy the entry of `key` to `target`, and return `target`. `make(path)` writes a missing entry.

        `key` (JSON) contains everything that the content depends on, including the version of its format. Exceptions
        of `make` pass through; raises OSError if `target` cannot be written.
        """
        entry = self.folder / hashlib.sha256(json.dumps(dict(key), sort_keys=True).encode()).hexdigest()
        target.unlink(missing_ok=True)  # it may be a link to another file
        if self._usable and self._copied(entry, target):
            return target
        try:
            make(target)
        except BaseException:
            target.unlink(missing_ok=True)
            raise
        if self._usable:
            self._keep(target, entry)
        return target

    def trim(self) -> None:
        """Delete the least recently used entries until the rest has at most `max_bytes`."""
        kept = 0
        with suppress(OSError):
            found = [(path, path.stat()) for path in self.folder.iterdir() if path.is_file()]
            for path, status in sorted(found, key=lambda entry: entry[1].st_mtime_ns, reverse=True):
                kept += status.st_size
                if kept > self._max_bytes:
                    path.unlink(missing_ok=True)

    def _copied(self, entry: Path, target: Path) -> bool:
        """Copy `entry` to `target`; returns False if there is no entry, or its checksum is wrong."""
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

    def _keep(self, made: Path, entry: Path) -> None:
        """Make `entry` of the file `made` and its checksum, complete or not at all."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with TemporaryDirectory(dir=self.folder, prefix="making-", ignore_cleanup_errors=True) as room:
                copy = Path(shutil.copyfile(made, Path(room) / entry.name))
                with copy.open("r+b") as file:
                    digest = hashlib.file_digest(file, "sha256").digest()
                    file.write(digest)
                copy.replace(entry)
        except FileNotFoundError:
            pass  # the user has emptied the cache meanwhile
        except OSError as error:
            self._cannot(error)

    def _cannot(self, error: OSError) -> None:
        self._usable = False
        self._report(
            f"{self.folder}: cannot be used ({error.strerror}), so nothing is cached; set XDG_CACHE_HOME to a folder"
            " with free space"
        )


def _copy_checked(file: BinaryIO, copy: BinaryIO) -> bool:
    """Copy `file` without the digest at its end; returns whether the digest is right."""
    left, digest = file.seek(0, os.SEEK_END) - DIGEST_BYTES, hashlib.sha256()
    file.seek(0)
    while left > 0 and (block := file.read(min(BLOCK_BYTES, left))):
        digest.update(block)
        copy.write(block)
        left -= len(block)
    return left == 0 and file.read() == digest.digest()
