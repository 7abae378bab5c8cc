"""Writing simulated tracks as a recording: as tracks, or rendered to scans."""

from __future__ import annotations

from pathlib import Path

from gridtrack.common.errors import RecordingError
from gridtrack.common.files import atomic_write
from gridtrack.recordings.formats.native_writer import write_native
from gridtrack.simulation.tracks import Tracks
from gridtrack.simulation.tracks_file import write_tracks

SIMULATED_SUFFIXES = (".tracks", ".mcap")


def check_suffix(out: Path) -> None:
    """Raise RecordingError for a name that ends neither in .tracks nor in .mcap; for use before a long simulation."""
    if out.suffix not in SIMULATED_SUFFIXES:
        raise RecordingError(f"{out}: a simulated recording is written as .tracks or as .mcap")


def write_recording(out: Path, tracks: Tracks) -> None:
    """Write `tracks` as `out.tracks`, or their scans as `out.mcap`; the scans are the same either way.

    Same tracks, same bytes. Raises RecordingError; `out` is then not changed.
    """
    check_suffix(out)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(out) as file:
            if out.suffix == ".tracks":
                write_tracks(file, tracks)
            else:
                write_native(file, tracks.info.recording, tracks.scans())
    except OSError as error:
        raise RecordingError(f"{out}: cannot be written ({error.strerror})") from None
