"""Files and folders in an object store or on a server: named by a URL, fetched into the user's cache, uploaded."""

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
"""What the file systems of fsspec call the version of a file; without any it is fetched again when its size changes."""
MAX_PART_BYTES = 255
"""Limit of the name of a file or folder inside a folder that is fetched: of most file systems."""


class StoredFile(NamedTuple):
    """A file in a store: its path there, its size in bytes, and what identifies its content."""

    path: str
    size: int
    version: str


def is_url(text: str) -> bool:
    """Whether `text` names something in a store, and not a path."""
    return URL.match(text) is not None


def fetched_file(url: str, kind: str, note: Callable[[str], None]) -> Path:
    """The local copy of a file, `<cache>/<kind>/<version>/<its name>`, whole or not at all.

    It is fetched where there is no copy of this version yet; `note` receives a line before that. Raises StoreError.
    """
    name = _checked_name(url, unquote(PurePosixPath(urlsplit(url).path).name))
    with _told_in_one_line(url, "fetched"):
        files, path = _file_system(url)
        stored = _stored(files, path, url, files.info(path))
        copy = user_cache_folder() / kind / stored.version / name
        if not copy.is_file():
            note(f"{url}: fetching {stored.size / 1e6:.1f} MB")
            _copy(files, stored, copy)
        return copy


def local_folder(text: str, kind: str, note: Callable[[str], None]) -> Path:
    """The folder at a path, or the local copy (`fetched_folder`) of the one at a URL. Raises StoreError."""
    return fetched_folder(text, kind, note) if is_url(text) else Path(text)


def fetched_folder(url: str, kind: str, note: Callable[[str], None]) -> Path:
    """The local copy of a folder as it is now, `<cache>/<kind>/<version>/<its name>`, whole or not at all.

    Its files are links to the copies of the single files, so that only those are fetched of which there is no copy of
    this version yet; `note` receives a line before that. Files below a hidden name are left out. Raises StoreError.
    """
    name, cache = folder_name(url), user_cache_folder() / kind
    with _told_in_one_line(url, "fetched"):
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
    """The name of the folder that a URL names: the last part of its path, or the bucket. Raises StoreError."""
    parts = urlsplit(url)
    return _checked_name(url, unquote(PurePosixPath(f"/{parts.hostname or ''}/{parts.path}").name))


def list_folder(url: str) -> dict[str, StoredFile]:
    """The files of a folder in a store by their names relative to it, `a/b`; none where there is no such folder.

    Raises StoreError.
    """
    folder_name(url)
    with _told_in_one_line(url, "listed"):
        files, path = _file_system(url)
        return _listed(files, path, url)


def upload_folder(folder: Path, url: str, last: str) -> None:
    """Upload the files of `folder` but the hidden ones, and the file named `last` after all others.

    What the store has under other names stays there. Raises StoreError where a file cannot be written, or has another
    size there.
    """
    folder_name(url)
    paths = (path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    names = [path.as_posix() for path in paths if not any(part.startswith(".") for part in path.parts)]
    with _told_in_one_line(url, "uploaded to"):
        files, root = _file_system(url)
        for name in sorted(names, key=lambda name: (name == last, name)):
            files.put_file(str(folder / name), f"{root.rstrip('/')}/{name}")
        files.invalidate_cache()
        there = _listed(files, root, url)
        for name in names:
            size = (folder / name).stat().st_size
            if name not in there or there[name].size != size:
                raise StoreError(f"{url}/{name}: is not there in its {size} bytes after the upload; try again")


@contextmanager
def _told_in_one_line(url: str, done: str) -> Iterator[None]:
    """Errors of file systems, of which each has its own, as StoreError."""
    try:
        yield
    except GridtrackError:
        raise
    except Exception as error:  # noqa: BLE001 every file system has errors of its own
        reason = bounded_line(str(error) or type(error).__name__)
        raise StoreError(f"{url}: cannot be {done} ({type(error).__name__}: {reason})") from None


def _checked_name(url: str, name: str) -> str:
    """`name`, the last part of `url`. Raises StoreError for one that no file can have here, and for a password."""
    if "@" in urlsplit(url).netloc:
        raise StoreError(f"{urlsplit(url).hostname}: leave user and password out of the URL: commands are recorded")
    if not is_name(name):
        raise StoreError(f"{url}: '{name}' cannot be the name of a local copy: {NAME_RULE}")
    return name


def _file_system(url: str) -> tuple[Any, str]:
    """The file system of a URL, which asks its store anew, and the path in it. Raises StoreError."""
    if "::" in url:
        raise StoreError(f"{url}: a chain of file systems is not supported; name the file or folder itself")
    try:
        from fsspec.core import url_to_fs
    except ImportError:
        raise StoreError(f"{url}: what is named by a URL needs gridtrack[remote]") from None
    # object stores have no folders to create, and the others create them; that of local files has to be told
    options = {"auto_mkdir": True} if url.startswith(("file://", "local://")) else {}
    try:
        files, path = url_to_fs(url, **options)
    except (ImportError, ValueError) as error:
        raise StoreError(f"{url}: {bounded_line(str(error))}") from None
    files.invalidate_cache()
    return files, path


def _stored(files: Any, path: str, url: str, information: Mapping[str, Any]) -> StoredFile:
    """The file at `path`, as its file system describes it. Raises StoreError where it does not tell the size."""
    size = information.get("size")
    if size is None:
        size = files.info(path).get("size")
    if size is None:
        raise StoreError(f"{url}: its size is not told, so a part would look like the whole: copy it here")
    told = {key: str(information[key]) for key in VERSION_KEYS if key in information} | {"size": str(size)}
    return StoredFile(path, size, _digest([url, told]))


def _listed(files: Any, root: str, url: str) -> dict[str, StoredFile]:
    """The files below `root` by their names relative to it, but the hidden ones; none where there is no such folder.

    Raises StoreError, and what the file system raises: half a list would look like the whole.
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
    """What the file system tells of each file below; its own `walk` and `find` leave out what cannot be listed."""
    for entry in files.ls(folder, detail=True):
        if entry["type"] != "directory":
            yield entry
        elif entry["name"].strip("/") != folder.strip("/"):
            yield from _files_below(files, entry["name"])


def _relative(path: str, root: str, url: str) -> str:
    """The name of the file at `path` relative to the folder `root`. Raises StoreError for one that leads elsewhere."""
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
    """Copy a file, whole or not at all. Raises StoreError where it has another size than was told."""
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
                raise StoreError(f"{path}: {made.tell()} bytes came, and {size} were announced; try again")
            made.flush()
            Path(made.name).replace(copy)
        finally:
            Path(made.name).unlink(missing_ok=True)


def _assemble(folder: Path, copies: Mapping[str, Path]) -> None:
    """Make `folder` of links to the copies of its files; one that another process made meanwhile is as good."""
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
