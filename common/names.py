"""Names of stretches, sites and recordings, which become parts of paths, and paths: what is allowed."""

from __future__ import annotations

from pathlib import Path

from gridtrack.common.errors import GridtrackError

MAX_NAME_BYTES = 160
NAME_RULE = (
    f"expected 1 to {MAX_NAME_BYTES} bytes of printable UTF-8 without / and \\, and no '.' or space at the beginning"
)
LABEL_RULE = f"expected 1 to {MAX_NAME_BYTES} bytes of printable UTF-8"


def check_utf8(path: Path | str, error: type[GridtrackError]) -> None:
    """Raise `error` for a path that is not UTF-8: no JSON and no terminal can hold it."""
    text = str(path)
    try:
        text.encode()
    except UnicodeEncodeError:
        shown = text.encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")
        raise error(f"{shown}: this path is not UTF-8, and results could not name it: rename it") from None


def is_name(text: str) -> bool:
    """Whether `text` can be the name of a file or folder: NAME_RULE."""
    return is_label(text) and not text.startswith((".", " ")) and "/" not in text and "\\" not in text


def is_label(text: str) -> bool:
    """Whether `text` can be shown and written: LABEL_RULE. A lone surrogate is not printable."""
    return text.isprintable() and 1 <= len(text.encode()) <= MAX_NAME_BYTES


def name_from(file_name: str) -> str:
    """A name from that of a file: the part before its first dot, other characters that a name cannot have replaced."""
    stem = file_name.lstrip(".").partition(".")[0]
    allowed = "".join(c if c.isprintable() and c not in "/\\" else "_" for c in stem).strip()
    return allowed.encode()[:MAX_NAME_BYTES].decode(errors="ignore") or "recording"
