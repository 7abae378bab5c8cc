"""The recording format of simulated tracks: recognised here, rendered by modules that are loaded on opening."""

from __future__ import annotations

from pathlib import Path

from gridtrack.recordings.format import RecordingFormat
from gridtrack.recordings.read_options import ReadOptions
from gridtrack.recordings.recording import Recording

PARQUET_MAGIC = b"PAR1"


def is_tracks(path: Path, head: bytes) -> bool:
    """Whether the file begins as a Parquet file."""
    return head.startswith(PARQUET_MAGIC)


def open_tracks(path: Path, options: ReadOptions) -> Recording:
    """The tracks as a recording that is rendered when it is read."""
    from gridtrack.simulation.rendered import RenderedRecording

    return RenderedRecording(path, options)


TRACKS_FORMAT = RecordingFormat("file of simulated tracks", (".tracks",), is_tracks, open_tracks)
