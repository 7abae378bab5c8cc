"""The files of the stretches of one training, most of them kept from an earlier one.

What is kept: the survey of each recording, and of each stretch its frames with labels, and its regions. A training gets
copies in a folder that has nothing else, so its `fit` reaches no other stretch by them and cannot damage what is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from gridtrack.common.cache import FileCache
from gridtrack.evaluation.runs.fit_regions import StoredKinds, StretchRegions, cell_kinds_for, store_regions
from gridtrack.evaluation.runs.stored_stretch import store_stretch
from gridtrack.recordings import Recording
from gridtrack.recordings.stream import GridStream
from gridtrack.recordings.survey_file import recall_survey, write_survey
from gridtrack.trackers.progress import Progress
from gridtrack.trackers.wire import WireError

STRETCHES_VERSION = 3
"""Increases with every change by which the same recording has another survey, other frames or labels."""
KINDS_VERSION = 2
"""Increases with every change by which the same frames have other kinds of cells, or other returns in motion."""
MAX_CACHE_BYTES = 10 << 30
"""Frames of about a hundred hours of simulated worlds."""


def stretch_cache(report: Callable[[str], None]) -> FileCache:
    """The folder `stretches` of the user's cache; `report` is told of faults."""
    return FileCache("stretches", MAX_CACHE_BYTES, report)


def surveyed(recording: Recording, cache: FileCache) -> Recording:
    """The `recording`, its survey taken from the cache, or made and kept there. Raises RecordingError, OSError."""
    with TemporaryDirectory(prefix="gridtrack-survey-") as folder:
        key = {"survey": _recording_key(recording)}
        path = cache.fetch(key, Path(folder) / "survey", lambda made: write_survey(recording, made))
        recall_survey(recording, path)
    return recording


class StretchFiles:
    """The files of the `streams` of a training: frames first, regions when they are asked for."""

    def __init__(self, streams: Sequence[GridStream], folder: Path, cache: FileCache) -> None:
        """They are copied to `folder`, which is the training's own."""
        self._streams, self._folder, self._cache = tuple(streams), folder, cache

    def frames(self, progress: Progress) -> list[Path]:
        """The files of frames and labels, in the order of the streams. Raises RecordingError, OSError."""
        files = []
        with progress.stage("stretch", len(self._streams)) as stage:
            for n, stream in enumerate(self._streams):
                files.append(self._frames(stream, self._folder / f"{n}.frames"))
                stage.advance(stream.name)
        self._cache.trim()
        return files

    def _frames(self, stream: GridStream, path: Path) -> Path:
        key = {"frames": _stretch_key(stream)}
        return self._cache.fetch(key, path, lambda made: store_stretch(stream, made))

    def regions(self, number: int) -> Path:
        """The file of the regions of stream `number`. Raises WireError without one, RecordingError, OSError."""
        if not 0 <= number < len(self._streams):
            raise WireError(f"regions of stretch {number}; there are {len(self._streams)}")
        stream = self._streams[number]
        beside = [other for other in self._streams if other.sha256 == stream.sha256 and other.grid == stream.grid]
        kinds = [KINDS_VERSION, *sorted(map(_stretch_key, beside), key=str)]
        key = {"regions": _stretch_key(stream), "kinds": kinds}
        path = self._folder / f"{number}.regions.npz"
        return self._cache.fetch(key, path, lambda made: store_regions(stream, cell_kinds_for(stream, beside), made))

    def kinds(self, number: int) -> StoredKinds:
        """The kinds of the cells of stream `number`. Raises RecordingError, OSError."""
        return StretchRegions.read(self.regions(number)).kinds


def _recording_key(recording: Recording) -> dict[str, Any]:
    """What the scans of a recording depend on."""
    return {
        "versions": [STRETCHES_VERSION, version("gridtrack"), recording.scans_version],
        "name": recording.name,
        "sha256": recording.sha256,
        "options": recording.options.model_dump(mode="json"),
    }


def _stretch_key(stream: GridStream) -> dict[str, Any]:
    """What the frames of a stretch depend on, and what their file says of it."""
    return {
        "recording": _recording_key(stream.recording),
        "stretch": [stream.name, stream.start_s, len(stream)],
        "grid": str(stream.grid),
        "period_ns": stream.period_ns,
        "points": stream.points,
    }
