"""The code of a tracker as one hash, by which two runs tell whether it was edited between them."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterator
from pathlib import Path

from gridtrack.common.files import sha256_of

INSTALLED = ("site-packages", "dist-packages")


def code_sha256(kind: type) -> str:
    """The hash of the loaded source files of the class `kind`: those of its package, and those below the folder of its
    module, without the libraries that are installed there. "" where it has no file, as in a notebook.
    """
    package = kind.__module__.partition(".")[0]
    files = dict(sorted(_files(package)))
    digest = hashlib.sha256()
    for name, path in files.items():
        digest.update(f"{name}:{sha256_of(path)}\n".encode())
    return digest.hexdigest() if files else ""


def program_sha256(argv: tuple[str, ...], folder: Path | None) -> str:
    """The hash of the program that `argv` starts in `folder`: of each of its words that names a file."""
    digests = [sha256_of(path) for path in (Path(folder or "", word) for word in argv) if _is_file(path)]
    return hashlib.sha256("\n".join(digests).encode()).hexdigest() if digests else ""


def _is_file(path: Path) -> bool:
    """Whether `path` is a file; a word of a command can also be too long for a path, or have a null byte."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def _files(package: str) -> Iterator[tuple[str, Path]]:
    """The name and the file of each loaded module that belongs to `package` or lies beside it."""
    top = getattr(sys.modules.get(package), "__file__", None)
    root = Path(top).parent if top else None
    for name, module in list(sys.modules.items()):
        path = Path(getattr(module, "__file__", None) or "")
        if path.is_file() and (name.partition(".")[0] == package or (root is not None and _lies_below(path, root))):
            yield name, path


def _lies_below(path: Path, root: Path) -> bool:
    """Whether a file lies below `root`, and is not of a library installed there."""
    if root.name in INSTALLED or not path.is_relative_to(root):
        return False
    return not set(INSTALLED) & set(path.relative_to(root).parts)
