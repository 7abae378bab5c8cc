"""Files and folders at URLs, in an object store or on a server: fetched into the user's cache, listed, uploaded."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple
from urllib.parse import unquote, urlsplit

from gridtrack.common.errors import GridtrackError, StoreError, bounded_line
from gridtrack.common.files import NAME_RULE, is_name, user_cache_folder

URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*://")
READ_BYTES = 1 << 22
VERSION_KEYS = ("ETag", "etag", "generation", "LastModified", "last_modified", "mtime")
"""Names of a file's version in the file systems of fsspec; without one the size alone shows a change."""
MAX_PART_BYTES = 255
"""Limit of a file name in most file systems."""


class StoredFile(NamedTuple):
    """A file in a store: its path there, its size in bytes, and a digest of its URL, size and version."""

    path: str
    size: int
    version: str


def is_url(text: str) -> bool:
    """Whether `text` is a URL, not a path."""
    return URL.match(text) is not None


def fetched_file(url: str, kind: str, note: Callable[[str], None]) -> Path:
    """The complete local copy of a file, `<cache>/<kind>/<version>/<its name>`.

    It is fetched unless the cache has this version; `note` receives a line before that. Raises StoreError.
    """
    name = _checked_name(url, unquote(PurePosixPath(urlsplit(url).path).name))
    with _as_store_error(url, "fetched"):
        files, path = _file_system(url)
        stored = _stored(files, path, url, files.info(path))
        copy = user_cache_folder() / kind / stored.version / name
        if not copy.is_file():
            note(f"{url}: fetching {stored.size / 1e6:.1f} MB")
            _copy(files, stored, copy)
        return copy


def local_folder(text: str, kind: str, note: Callable[[str], None]) -> Path:
    """The folder at a path, or the local copy (`fetched_folder`) of a folder at a URL. Raises StoreError."""
    return fetched_folder(text, kind, note) if is_url(text) else Path(text)


def fetched_folder(url: str, kind: str, note: Callable[[str], None]) -> Path:
    """The complete local copy of a folder as it is now, `<cache>/<kind>/<version>/<its name>`.

    Its files are links to the cached copies of the single files: only new versions are fetched, after a line to `note`.
    Hidden files and folders are left out. Raises StoreError.
    """
    name, cache = folder_name(url), user_cache_folder() / kind
    with _as_store_error(url, "fetched"):
        files, path = _file_system(url)
        found = _listed(files, path, url)
        if not found:
            raise StoreError(f"{url}: there is no such folder, or no file in it")
        folder = cache / _digest([url, {relative: stored.version for relative, stored in found.items()}]) / name
        if folder.is_dir():
            return folder
        copies = {relative: cache / found[relative].version / PurePosixPath(relative).name for relative in found}
        missing = [relative for relative, copy in copies.items() if not copy.is_file()]
        if missing:
            size = sum(found[relative].size for relative in missing)
            note(f"{url}: fetching {len(missing)} of {len(found)} files, {size / 1e6:.1f} MB")
        for relative in missing:
            _copy(files, found[relative], copies[relative])
        _assemble(folder, copies)
        return folder


def folder_name(url: str) -> str:
    """The name of the folder at a URL: the last part of its path, or the bucket. Raises StoreError."""
    parts = urlsplit(url)
    return _checked_name(url, unquote(PurePosixPath(f"/{parts.hostname or ''}/{parts.path}").name))


def list_folder(url: str) -> dict[str, StoredFile]:
    """The files of a folder in a store by their relative names, `a/b`; empty if there is no such folder.

    Raises StoreError.
    """
    folder_name(url)
    with _as_store_error(url, "listed"):
        files, path = _file_system(url)
        return _listed(files, path, url)


def upload_folder(folder: Path, url: str, last: str) -> None:
    """Upload the files of `folder` except hidden ones, the file named `last` after all others.

    Other files in the store stay. Raises StoreError if a file cannot be written or arrives with another size.
    """
    folder_name(url)
    paths = (path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    names = [path.as_posix() for path in paths if not any(part.startswith(".") for part in path.parts)]
    with _as_store_error(url, "uploaded to"):
        files, root = _file_system(url)
        for name in sorted(names, key=lambda name: (name == last, name)):
            files.put_file(str(folder / name), f"{root.rstrip('/')}/{name}")
        files.invalidate_cache()
        there = _listed(files, root, url)
        for name in names:
            size = (folder / name).stat().st_size
            if name not in there or there[name].size != size:
                raise StoreError(f"{url}/{name}: the upload is not complete; try again")


@contextmanager
def _as_store_error(url: str, done: str) -> Iterator[None]:
    """Turn the errors of any file system into StoreError."""
    try:
        yield
    except GridtrackError:
        raise
    except Exception as error:  # noqa: BLE001 every file system has its own errors
        reason = bounded_line(str(error) or type(error).__name__)
        raise StoreError(f"{url}: cannot be {done} ({type(error).__name__}: {reason})") from None


def _checked_name(url: str, name: str) -> str:
    """`name`, the last part of `url`. Raises StoreError for an invalid file name, and for a password in the URL."""
    if "@" in urlsplit(url).netloc:
        raise StoreError(f"{urlsplit(url).hostname}: leave user and password out of the URL: commands are recorded")
    if not is_name(name):
        raise StoreError(f"{url}: '{name}' cannot be the name of a local copy: {NAME_RULE}")
    return name


def _file_system(url: str) -> tuple[Any, str]:
    """The file system of a URL, without cached listings, and the path in it. Raises StoreError."""
    if "::" in url:
        raise StoreError(f"{url}: a chain of file systems is not supported; name the file or folder itself")
    try:
        from fsspec.core import url_to_fs
    except ImportError:
        raise StoreError(f"{url}: reading a URL needs gridtrack[remote]") from None
    # only the file system of local files does not create folders by itself
    options = {"auto_mkdir": True} if url.startswith(("file://", "local://")) else {}
    try:
        files, path = url_to_fs(url, **options)
    except (ImportError, ValueError) as error:
        raise StoreError(f"{url}: {bounded_line(str(error))}") from None
    files.invalidate_cache()
    return files, path


def _stored(files: Any, path: str, url: str, information: Mapping[str, Any]) -> StoredFile:
    """The file at `path`, as its file system describes it. Raises StoreError if its size is not known."""
    size = information.get("size")
    if size is None:
        size = files.info(path).get("size")
    if size is None:
        raise StoreError(
            f"{url}: the server does not send its size, so a cut download would go unnoticed: copy it here"
        )
    version = {key: str(information[key]) for key in VERSION_KEYS if key in information} | {"size": str(size)}
    return StoredFile(path, size, _digest([url, version]))


def _listed(files: Any, root: str, url: str) -> dict[str, StoredFile]:
    """The files below `root` by their relative names, except hidden ones; empty if there is no such folder.

    Raises StoreError; errors of the file system pass through, since an incomplete list would look complete.
    """
    try:
        files.ls(root, detail=True)
    except FileNotFoundError:
        return {}
    named = {_relative(entry["name"], root, url): entry for entry in _files_below(files, root)}
    return {
        name: _stored(files, entry["name"], f"{url}/{name}", entry)
        for name, entry in named.items()
        if not any(part.startswith(".") for part in name.split("/"))
    }


def _files_below(files: Any, folder: str) -> Iterator[dict[str, Any]]:
    """The entry of each file below; `walk` and `find` of fsspec silently skip folders that cannot be listed."""
    for entry in files.ls(folder, detail=True):
        if entry["type"] != "directory":
            yield entry
        elif entry["name"].strip("/") != folder.strip("/"):
            yield from _files_below(files, entry["name"])


def _relative(path: str, root: str, url: str) -> str:
    """The name of the file at `path` relative to the folder `root`. Raises StoreError if it lies outside."""
    folder = f"{root.strip('/')}/"
    if not path.strip("/").startswith(folder):
        raise StoreError(f"{url}: is not a folder, or lists a file outside itself ({path})")
    name = path.strip("/").removeprefix(folder)
    if "://" in path:
        name = unquote(name)
    for part in name.split("/"):
        wrong = part in ("", ".", "..") or "\\" in part or not part.isprintable()
        if wrong or len(part.encode()) > MAX_PART_BYTES:
            raise StoreError(f"{url}: holds a file that cannot be named here ({name}): rename it in the store")
    return name


def _digest(content: Any) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:32]


def _copy(files: Any, stored: StoredFile, copy: Path) -> None:
    """Copy a file completely or not at all. Raises StoreError if its size is not the announced one."""
    path, size, _ = stored
    copy.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=copy.parent, prefix=".fetching-", delete=False) as made:
        try:
            with files.open(path, "rb") as source:
                while block := source.read(READ_BYTES):
                    made.write(block)
                    if made.tell() > size:
                        break
            if made.tell() != size:
                raise StoreError(f"{path}: received {made.tell()} bytes instead of {size}; try again")
            made.flush()
            Path(made.name).replace(copy)
        finally:
            Path(made.name).unlink(missing_ok=True)


def _assemble(folder: Path, copies: Mapping[str, Path]) -> None:
    """Fill `folder` with links to the copies of its files, unless another process has done so meanwhile."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    made = Path(tempfile.mkdtemp(dir=folder.parent, prefix=".fetching-"))
    try:
        for relative, copy in copies.items():
            (made / relative).parent.mkdir(parents=True, exist_ok=True)
            os.link(copy, made / relative)
        made.rename(folder)
    except OSError:
        if not folder.is_dir():
            raise
    finally:
        shutil.rmtree(made, ignore_errors=True)
