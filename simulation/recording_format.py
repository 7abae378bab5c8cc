"""The recording format of simulated tracks."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from gridtrack.common.errors import RecordingError
from gridtrack.common.files import sha256_of, user_cache_folder
from gridtrack.common.scan import Scan
from gridtrack.recordings.formats.native import NativeRecording, write_native
from gridtrack.recordings.recording import Recording, Topics
from gridtrack.recordings.recording_info import RecordingInfo
from gridtrack.recordings.registry import RecordingFormat

if TYPE_CHECKING:
    from gridtrack.simulation.tracks import Tracks

PARQUET_MAGIC = b"PAR1"
RENDERING_VERSION = 1
"""Increases with every change that renders the same tracks to other scans, so that an older rendering is not used."""


def is_tracks(path: Path, head: bytes) -> bool:
    """Whether the file begins as a Parquet file."""
    return head.startswith(PARQUET_MAGIC)


class RenderedRecording(Recording):
    """Simulated tracks: their scans are rendered into a native recording in the cache when they are first read.

    Path, name and hash belong to the file of tracks, so that a run names its input.
    """

    @cached_property
    def info(self) -> RecordingInfo:
        """The metadata in the file of tracks. Raises RecordingError."""
        return self._read_tracks().info.recording

    @property
    def scans_version(self) -> str:
        """The version of the rendering."""
        return f"rendering {RENDERING_VERSION}"

    def read(self, topics: Topics) -> Iterator[Scan]:
        """The scans of the rendering."""
        if not self.rendering.is_file():
            del self.rendering  # the user has emptied the cache meanwhile
        return NativeRecording(self.rendering, self.options).read(topics)

    @cached_property
    def rendering(self) -> Path:
        """The native recording in the cache, rendered again if its hash differs from that in the file beside it."""
        rendering = rendering_folder() / f"{self.sha256[:40]}-{RENDERING_VERSION}.mcap"
        if not rendering.is_file() or sha256_of(rendering) != _expected_sha256(rendering):
            self._render(rendering)
        return rendering

    def _read_tracks(self) -> Tracks:
        from gridtrack.simulation.tracks_file import read_tracks  # loads pyarrow and Numba

        return read_tracks(self.path)

    def _render(self, rendering: Path) -> None:
        """Several processes may render at once: each writes files of its own with equal content and moves them."""
        tracks = self._read_tracks()
        try:
            rendering.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(dir=rendering.parent) as folder:
                scans, checksum = Path(folder) / "rendering.mcap", Path(folder) / "rendering.sha256"
                with scans.open("wb") as file:
                    write_native(file, tracks.info.recording, tracks.scans())
                checksum.write_text(f"{sha256_of(scans)}\n")
                scans.replace(rendering)
                checksum.replace(rendering.with_suffix(".sha256"))
        except OSError as error:
            raise RecordingError(
                f"{rendering}: the rendering of {self.name} cannot be written ({error.strerror}); set XDG_CACHE_HOME to"
                " a folder with room"
            ) from None


def rendering_folder() -> Path:
    """The folder of the renderings in the user's cache. It may be emptied at any time."""
    return user_cache_folder() / "renderings"


def _expected_sha256(rendering: Path) -> str | None:
    checksum = rendering.with_suffix(".sha256")
    return checksum.read_text(errors="replace").strip() if checksum.is_file() else None


TRACKS_FORMAT = RecordingFormat("file of simulated tracks", (".tracks",), is_tracks, RenderedRecording)
