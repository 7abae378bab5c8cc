"""Recordings that are named by a URL, with a stretch: read from the local copy."""

from __future__ import annotations

from collections.abc import Callable

from gridtrack.common.remote_files import fetched_file, is_url


def fetched(text: str, note: Callable[[str], None]) -> str:
    """RECORDING[@RANGE] with the local copy of a recording that is named by a URL; another text as it is.

    The copy lies in `$XDG_CACHE_HOME/gridtrack/recordings`, under the file's own name, and is fetched again when the
    file has changed. `note` receives a line before that. Raises StoreError.
    """
    if not is_url(text):
        return text
    url, stretch = _without_stretch(text)
    return f"{fetched_file(url, 'recordings', note)}{stretch}"


def _without_stretch(text: str) -> tuple[str, str]:
    """The URL, and `@RANGE` after its last part or nothing."""
    folder, slash, last = text.rpartition("/")
    name, at, stretch = last.rpartition("@")
    return (f"{folder}{slash}{name}", f"{at}{stretch}") if at else (text, "")
