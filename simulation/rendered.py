"""A file of tracks as a recording: rendered on first use, and kept in the user's cache."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path

from gridtrack.common.errors import RecordingError
from gridtrack.common.scan import Scan
from gridtrack.recordings.formats.native import NativeRecording, write_native
from gridtrack.recordings.recording import Recording, RecordingInfo, Topics
from gridtrack.simulation.tracks import read_tracks

RENDERING = 1
"""Rises whenever the same tracks would be rendered to other scans, so that no older rendering is taken for them."""


class RenderedRecording(Recording):
    """Tracks whose scans are those of a native recording in the cache, made there when it is missing or damaged.

    Path, name and hash are those of the tracks: they are what a run was made of.
    """

    @cached_property
    def info(self) -> RecordingInfo:
        """What the tracks say about themselves."""
        return read_tracks(self.path).info.recording

    def read(self, topics: Topics) -> Iterator[Scan]:
        """The scans of the rendering."""
        return NativeRecording(self.rendering, self.options).read(topics)

    @cached_property
    def rendering(self) -> Path:
        """The native recording in the cache, checked against the hash that it was kept with."""
        kept = cache_folder() / f"{self.sha256[:40]}-{RENDERING}.mcap"
        if _hash_beside(kept) != _sha256(kept):
            self._render(kept)
        return kept

    def _render(self, kept: Path) -> None:
        """Several processes may render at once: each writes a file of its own, all the same, and moves it in place."""
        tracks = read_tracks(self.path)
        try:
            kept.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(dir=kept.parent) as folder:
                made, beside = Path(folder) / "rendering.mcap", Path(folder) / "rendering.sha256"
                with made.open("wb") as file:
                    write_native(file, tracks.info.recording, tracks.scans())
                beside.write_text(f"{_sha256(made)}\n")
                made.replace(kept)
                beside.replace(kept.with_suffix(".sha256"))
        except OSError as error:
            raise RecordingError(
                f"{kept}: the rendering of {self.name} cannot be kept ({error.strerror}); set XDG_CACHE_HOME to a"
                " folder with room"
            ) from None


def cache_folder() -> Path:
    """Where renderings are kept: `$XDG_CACHE_HOME/gridtrack/renderings` on Linux. It may be emptied at any time."""
    home = os.environ.get("XDG_CACHE_HOME", "")
    base = Path(home) if Path(home).is_absolute() else Path.home() / ".cache"
    return base / "gridtrack" / "renderings"


def _hash_beside(kept: Path) -> str | None:
    beside = kept.with_suffix(".sha256")
    return beside.read_text(errors="replace").strip() if beside.is_file() else None


def _sha256(path: Path) -> str:
    """Hash of a file; empty where there is none."""
    if not path.is_file():
        return ""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
