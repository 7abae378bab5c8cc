"""Files: atomic writes, bounded reads of regular files, hashes, valid names; the user's folders for data and cache.

A folder that was received from somebody may hold links and pipes with any name. Files are therefore written under a
name that nobody can foresee, and only regular files are read.
"""

from __future__ import annotations

import errno
import hashlib
import os
import re
import secrets
import stat
import unicodedata
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import platformdirs

from gridtrack.common.errors import GridtrackError, one_line, printable
from gridtrack.common.untrusted import parse_json

APPLICATION = "gridtrack"
PACKED_SUFFIXES = (".gz", ".bz2", ".zst", ".zstd")
PARTIAL_SUFFIX = ".partial"
MAX_NAME_BYTES = 160
LOG_END_BYTES = 4096
MAX_FOLDERS = 32
"""Limit of folders in each other; a run has 6."""
CONFLICT_MARK = re.compile(rb"^(?:<{7}|>{7}) ", re.MULTILINE)
LFS_POINTER = b"version https://git-lfs"
NOT_PULLED = "a Git LFS pointer: run `git lfs pull` in its repository"
NO_JSON = {
    b"\xef\xbb\xbf": "it begins with a byte order mark (BOM): save it as UTF-8 without one",
    b"\xff\xfe": "it is UTF-16: save it as UTF-8",
    b"\xfe\xff": "it is UTF-16: save it as UTF-8",
    LFS_POINTER: f"it is {NOT_PULLED}",
}
"""Files that are no JSON, by their first bytes, with the remedy."""
FULL = (errno.ENOSPC, errno.EDQUOT)
FREE_SPACE = "free space there, or write to another disk"
NOT_A_FILE = "a pipe, a socket or a device"
NAME_RULE = (
    f"expected 1 to {MAX_NAME_BYTES} bytes of printable UTF-8 without / and \\, and no '.' or space at the beginning"
)
LABEL_RULE = f"expected 1 to {MAX_NAME_BYTES} bytes of printable UTF-8"


@contextmanager
def atomic_write(path: Path, *, keep_on_error: bool = False) -> Iterator[BinaryIO]:
    """Open a new file beside `path` that replaces `path` when the block ends; a link at `path` is not followed.

    A reader sees either the old or the new content, never a part. If the block raises, `path` is not changed, or with
    `keep_on_error` has the content written so far. Raises OSError.
    """
    with replacing(path, keep_on_error=keep_on_error) as partial, partial.open("xb") as file:
        yield file


@contextmanager
def replacing(path: Path, *, keep_on_error: bool = False) -> Iterator[Path]:
    """The name of a new file beside `path`, for the block to write, that replaces `path` as in `atomic_write`.

    A full disk is as in `naming_full_disk`.
    """
    partial = path.with_name(f"{path.name}.{secrets.token_hex(8)}{PARTIAL_SUFFIX}")
    with naming_full_disk(path):
        try:
            yield partial
        except BaseException:
            if keep_on_error and partial.exists():
                partial.replace(path)
            partial.unlink(missing_ok=True)
            raise
        partial.replace(path)


@contextmanager
def naming_full_disk(path: Path) -> Iterator[None]:
    """In the block, which writes `path`, the OSError of a full disk names `path` and the remedy."""
    try:
        yield
    except OSError as error:
        if error.errno not in FULL:
            raise
        raise OSError(error.errno, f"{os.strerror(error.errno)}: {FREE_SPACE}", str(path)) from error


def open_new(path: Path) -> BinaryIO:
    """Open a new file to write in place of one at `path`, which may be a link or another name of any file."""
    path.unlink(missing_ok=True)
    return path.open("xb")


def remove_partial_files(folder: Path) -> None:
    """Remove files that an earlier process, killed while it wrote, left in `folder`."""
    for partial in folder.glob(f"*{PARTIAL_SUFFIX}"):
        partial.unlink(missing_ok=True)


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file to read; a pipe or a device, which could block for ever, raises OSError at once."""
    file = os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb")
    if stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        return file
    file.close()
    raise OSError(0, NOT_A_FILE, str(path))


def refuse_links(folder: Path, error: type[GridtrackError], unread: str = "", left: int = MAX_FOLDERS) -> None:
    """Raise `error` for the first link, pipe or device in `folder` or below, but for a folder `unread` in it.

    Its maker could direct our output to any file of the user. Also for more than `left` folders in each other.
    """
    if not left:
        raise error(f"{folder}: more than {MAX_FOLDERS} folders in each other: remove it")
    for entry in os.scandir(folder):
        if entry.is_dir(follow_symlinks=False):
            if entry.name != unread:
                refuse_links(Path(entry.path), error, left=left - 1)
        elif not entry.is_file(follow_symlinks=False):
            what = "a link" if entry.is_symlink() else NOT_A_FILE
            raise error(f"{entry.path}: {what}; gridtrack uses a folder of files and folders alone: remove it")


def write_text(path: Path, text: str) -> None:
    """Replace the content of `path` by `text` (UTF-8). Raises OSError."""
    with atomic_write(path) as file:
        file.write(text.encode())


def read_bounded(path: Path, max_bytes: int, error: type[GridtrackError]) -> bytes:
    """The content of `path`; at most `max_bytes` + 1 bytes are read.

    Raises FileNotFoundError, so that the caller can name the missing file, and `error` if the file cannot be read or is
    larger than `max_bytes`.
    """
    try:
        with open_regular(path) as file:
            content = file.read(max_bytes + 1)
    except FileNotFoundError:
        raise
    except OSError as problem:
        raise error(f"{path}: cannot be read ({problem.strerror})") from None
    if len(content) > max_bytes:
        raise error(f"{path}: larger than {max_bytes} bytes: refused")
    return content


def last_line(log: Path, max_chars: int) -> str:
    """The last line with text in a log, at most `max_chars`; empty if there is none, or no such file."""
    try:
        with log.open("rb") as file:
            file.seek(max(0, log.stat().st_size - LOG_END_BYTES))
            lines = file.read(LOG_END_BYTES).decode(errors="replace").splitlines()
    except OSError:
        return ""
    return next(filter(None, (one_line(line, max_chars) for line in reversed(lines))), "")


def read_json(path: Path, max_bytes: int, error: type[GridtrackError]) -> dict[str, Any]:
    """The JSON object in `path`, with None for numbers that are not finite.

    Raises FileNotFoundError, and `error` for a larger file or other content.
    """
    text = read_bounded(path, max_bytes, error)
    try:
        content = parse_json(text, undefined=True)
    except ValueError as problem:
        raise error(f"{path}: not JSON that can be read ({_why_no_json(text) or str(problem)[:80]})") from None
    if not isinstance(content, dict):
        raise error(f"{path}: expected one JSON object, found {type(content).__name__}")
    return content


def _why_no_json(text: bytes) -> str:
    """Kind of a file that is no JSON, and the remedy; empty if unknown."""
    if mark := CONFLICT_MARK.search(text):
        line = text.count(b"\n", 0, mark.start()) + 1
        return f"line {line} is the mark of a merge conflict: choose a side with `git checkout --ours` or `--theirs`"
    return next((why for head, why in NO_JSON.items() if text.startswith(head)), "" if text else "it is empty")


def sha256_of(path: Path, limit: int | None = None) -> str:
    """SHA-256 of a file, or of all files in a folder and below, in the order of their paths: 64 hexadecimal digits.

    At most the first `limit` bytes of each file are read, in pieces. Raises OSError.
    """
    digest = hashlib.sha256()
    for part in sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]:
        with open_regular(part) as file:
            while block := file.read(1 << 20 if limit is None else min(1 << 20, limit - file.tell())):
                digest.update(block)
    return digest.hexdigest()


def user_data_folder() -> Path:
    """The folder for permanent data: `$XDG_DATA_HOME/gridtrack` on Linux. It may not exist."""
    return Path(platformdirs.user_data_path(APPLICATION))


def user_cache_folder() -> Path:
    """The folder for reproducible data: `$XDG_CACHE_HOME/gridtrack` on Linux. It may not exist."""
    return Path(platformdirs.user_cache_path(APPLICATION))


def check_utf8(path: Path | str, error: type[GridtrackError]) -> None:
    """Raise `error` for a path that is not UTF-8: JSON and terminals cannot represent it."""
    text = str(path)
    try:
        text.encode()
    except UnicodeEncodeError:
        shown = text.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")
        raise error(f"{shown}: this path is not UTF-8, and results could not name it: rename it") from None


def check_path(path: Path | str, error: type[GridtrackError]) -> None:
    """Raise `error` for a path that results and messages cannot name: not UTF-8, or with control characters."""
    check_utf8(path, error)
    if any(unicodedata.category(sign) == "Cc" for sign in str(path)):
        raise error(f"{printable(str(path))}: this path has control characters: rename it")


def is_name(text: str) -> bool:
    """Whether `text` can be the name of a file or folder: NAME_RULE."""
    return is_label(text) and not text.startswith((".", " ")) and "/" not in text and "\\" not in text


def is_label(text: str) -> bool:
    """Whether `text` can be shown and written: LABEL_RULE. A lone surrogate is not printable."""
    return text.isprintable() and 1 <= len(text.encode()) <= MAX_NAME_BYTES


def name_from(path: Path) -> str:
    """A valid name from a file's name without its ending, or from a folder's, with invalid characters replaced."""
    stem = path.name
    if not path.is_dir():
        packed = Path(stem).suffix.lower() in PACKED_SUFFIXES
        stem = Path(Path(stem).stem).stem if packed else Path(stem).stem
    allowed = "".join(c if c.isprintable() and c not in "/\\" else "_" for c in stem).lstrip(". ").strip()
    return allowed.encode()[:MAX_NAME_BYTES].decode(errors="ignore") or "recording"
