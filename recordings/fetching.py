"""Recordings in an object store or on a server: named by a URL, fetched once, and read from the local copy."""

from __future__ import annotations

import hashlib
import json
import re
import tempfile
from collections.abc import Callable
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote, urlsplit

from gridtrack.common.errors import RecordingError, bounded_line
from gridtrack.common.files import user_cache_folder
from gridtrack.common.names import NAME_RULE, is_name

URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*://")
READ_BYTES = 1 << 22
VERSION_KEYS = ("ETag", "etag", "generation", "LastModified", "last_modified", "mtime")
"""What the file systems of fsspec call the version of a file; without any it is fetched again when its size changes."""


def fetched(text: str, note: Callable[[str], None]) -> str:
    """RECORDING[@RANGE] with the local copy of a recording that is named by a URL; another text as it is.

    The copy lies in `$XDG_CACHE_HOME/gridtrack/recordings`, under the file's own name, and is fetched again when the
    file has changed. `note` receives a line before that. Raises RecordingError.
    """
    if not URL.match(text):
        return text
    url, stretch = _without_stretch(text)
    name = unquote(PurePosixPath(urlsplit(url).path).name)
    if not is_name(name):
        raise RecordingError(f"{url}: '{name}' cannot be the name of a recording: {NAME_RULE}")
    if "@" in urlsplit(url).netloc:
        raise RecordingError(f"{urlsplit(url).hostname}: leave user and password out of the URL: commands are recorded")
    try:
        copy = _local_copy(url, name, note)
    except RecordingError:
        raise
    except Exception as error:  # noqa: BLE001 every file system has errors of its own
        reason = bounded_line(str(error) or type(error).__name__)
        raise RecordingError(f"{url}: cannot be fetched ({type(error).__name__}: {reason})") from None
    return f"{copy}{stretch}"


def _local_copy(url: str, name: str, note: Callable[[str], None]) -> Path:
    """The local copy of a file as it is now, fetched where there is none. Raises what its file system raises."""
    files, path = _file_system(url)
    information = files.info(path)
    size = information.get("size")
    if size is None:
        raise RecordingError(f"{url}: its size is not told, so a part would look like the whole: copy it here")
    copy = user_cache_folder() / "recordings" / _version(url, information) / name
    if not copy.is_file():
        note(f"{url}: fetching {size / 1e6:.1f} MB")
        _copy(files, path, copy, size)
    return copy


def _without_stretch(text: str) -> tuple[str, str]:
    """The URL, and `@RANGE` after its last part or nothing."""
    folder, slash, last = text.rpartition("/")
    name, at, stretch = last.rpartition("@")
    return (f"{folder}{slash}{name}", f"{at}{stretch}") if at else (text, "")


def _file_system(url: str) -> tuple[Any, str]:
    """The file system of a URL, and the path in it."""
    if "::" in url:
        raise RecordingError(f"{url}: a chain of file systems is not a recording; name the file itself")
    try:
        from fsspec.core import url_to_fs
    except ImportError:
        raise RecordingError(f"{url}: a recording named by a URL needs gridtrack[remote]") from None
    try:
        return url_to_fs(url)  # type: ignore[no-any-return]
    except (ImportError, ValueError) as error:
        raise RecordingError(f"{url}: {bounded_line(str(error))}") from None


def _version(url: str, information: dict[str, Any]) -> str:
    """Identifies the content of the file, as far as its file system tells."""
    told = {key: str(information[key]) for key in ("size", *VERSION_KEYS) if key in information}
    return hashlib.sha256(json.dumps([url, told], sort_keys=True).encode()).hexdigest()[:32]


def _copy(files: Any, path: str, copy: Path, size: int) -> None:
    """Copy a file of `size` bytes, whole or not at all. Raises RecordingError where it has another size."""
    copy.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=copy.parent, prefix=".fetching-", delete=False) as made:
        try:
            with files.open(path, "rb") as source:
                while block := source.read(READ_BYTES):
                    made.write(block)
                    if made.tell() > size:
                        break
            if made.tell() != size:
                raise RecordingError(f"{path}: {made.tell()} bytes came, and {size} were announced; try again")
            made.flush()
            Path(made.name).replace(copy)
        finally:
            Path(made.name).unlink(missing_ok=True)
