"""Recordings that ship with gridtrack, each surveyed and read once: their files stay as they are.

So is each content that many tests write: `write_shared`.
"""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from itertools import count
from pathlib import Path
from typing import Any

import pytest

from gridtrack.common.scan import Scan
from gridtrack.recordings.recording import Recording, scans_between

DATA = Path(__file__).resolve().parents[2] / "data"
Key = tuple[Any, Path | str, str]
_shared: set[str] = set()
"""SHA-256 of contents that many tests write."""
MAX_SHARED_BYTES = 1 << 22


def write_shared(path: Path, content: bytes) -> Path:
    """Write a recording that other tests write as well; returns `path`."""
    path.write_bytes(content)
    _shared.add(hashlib.sha256(content).hexdigest())
    return path


class Scans:
    """The scans of `reading`, which is read as far as an iteration needs it; for all threads."""

    def __init__(self, reading: Iterator[Scan]) -> None:
        self._reading, self._read, self._lock = reading, list[Scan](), threading.Lock()

    def __iter__(self) -> Iterator[Scan]:
        for number in count():
            with self._lock:
                if number == len(self._read):
                    self._read += [scan for scan in (next(self._reading, None),) if scan is not None]
                if number == len(self._read):
                    return
            yield self._read[number]


@contextmanager
def shipped_recordings_read_once() -> Iterator[None]:
    """In the block, recordings opened with the same options share their survey and their scans.

    Those below DATA by their path, those of `write_shared` by their content, where a test does not replace `read`.
    """
    surveyed: Any = Recording.survey
    scans_of = Recording.scans
    surveys: dict[Key, tuple[Any, list[str], str]] = {}
    read: dict[Key, Scans] = {}
    contents: dict[Key, list[Scan]] = {}

    def key_of(recording: Recording) -> Key | None:
        path = recording.path.resolve()
        if DATA not in path.parents or recording.growth is not None:
            return None
        return type(recording), path, recording.options.model_dump_json()

    def content_of(recording: Recording) -> Key | None:
        path = recording.path
        if recording.growth is not None or not path.is_file() or path.stat().st_size > MAX_SHARED_BYTES:
            return None
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        return (type(recording).read, digest, recording.options.model_dump_json()) if digest in _shared else None

    def survey(recording: Recording) -> Any:
        if (key := key_of(recording) or content_of(recording)) is None:
            return surveyed.func(recording)
        if key not in surveys:
            surveys[key] = surveyed.func(recording), recording.warning_texts(), recording.damage
        recording.recall(*surveys[key])
        return surveys[key][0]

    def scans(recording: Recording, start_s: float | None = None, end_s: float | None = None) -> Iterator[Scan]:
        if (key := key_of(recording)) is not None:
            return scans_between(read.setdefault(key, Scans(scans_of(recording))), start_s, end_s)
        if (key := content_of(recording)) is None:
            return scans_of(recording, start_s, end_s)
        if key not in contents:  # read to its end: its file may not stay as it is
            contents[key] = list(scans_of(recording))
        return scans_between(iter(contents[key]), start_s, end_s)

    once: Any = cached_property(survey)
    once.__set_name__(Recording, "survey")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Recording, "survey", once)
        patch.setattr(Recording, "scans", scans)
        yield
