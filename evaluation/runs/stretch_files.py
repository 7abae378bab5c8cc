"""The files of the stretches of one training: frames with labels, and regions; most are kept from an earlier training.

Kept are the survey of each recording, and the frames with labels and the regions of each stretch. A training gets
copies in its own folder, so its `fit` reaches no other stretch, and cannot damage the kept files.
"""

from __future__ import annotations

import gzip
from collections.abc import Callable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Any

from gridtrack.common.cache import FileCache
from gridtrack.common.files import atomic_write
from gridtrack.common.grid import GridFrame, LabelledFrame
from gridtrack.evaluation.runs.fit_regions import StoredKinds, StretchRegions, cell_kinds_for, store_regions
from gridtrack.recordings import Recording
from gridtrack.recordings.observation import check_labels, labelled_returns
from gridtrack.recordings.stream import GridStream
from gridtrack.recordings.survey import recall_survey, write_survey
from gridtrack.trackers import messages
from gridtrack.trackers.contract import stream_of
from gridtrack.trackers.training.progress import Progress
from gridtrack.trackers.wire import Fill, Message, WireError, encode, receive

STRETCHES_VERSION = 4
"""Increases with every change to the frames or the labels of the same recording."""
SURVEY_VERSION = 3
"""Increases with every change to the survey of the same recording."""
KINDS_VERSION = 3
"""Increases with every change to the kinds of cells, or the returns in motion, of the same frames."""
MAX_CACHE_BYTES = 10 << 30
"""Frames of about a hundred hours of simulated worlds."""


def stretch_cache(report: Callable[[str], None]) -> FileCache:
    """The folder `stretches` of the user's cache; `report` receives its problems."""
    return FileCache("stretches", MAX_CACHE_BYTES, report)


def surveyed(recording: Recording, cache: FileCache) -> Recording:
    """The `recording` with its survey from the cache, where it is made if missing. Raises RecordingError, OSError."""
    with TemporaryDirectory(prefix="gridtrack-survey-") as folder:
        key = {"survey": _recording_key(recording), "version": SURVEY_VERSION}
        path = cache.fetch(key, Path(folder) / "survey", lambda made: write_survey(recording, made))
        recall_survey(recording, path)
    return recording


class StretchFiles:
    """The files of the `streams` of a training: frames first, regions when they are requested."""

    def __init__(self, streams: Sequence[GridStream], folder: Path, cache: FileCache) -> None:
        """They are copied to `folder`, which is the training's own."""
        self.streams, self._folder, self._cache = tuple(streams), folder, cache

    def frames(self, progress: Progress) -> list[Path]:
        """The files of frames and labels, in the order of the streams. Raises RecordingError, OSError."""
        files = []
        with progress.stage("stretch", len(self.streams)) as stage:
            for n, stream in enumerate(self.streams):
                files.append(self._frames(stream, self._folder / f"{n}.frames"))
                stage.advance(stream.name)
        self._cache.trim()
        return files

    def _frames(self, stream: GridStream, path: Path) -> Path:
        key = {"frames": _stretch_key(stream)}
        return self._cache.fetch(key, path, lambda made: store_stretch(stream, made))

    def regions(self, number: int) -> Path:
        """The file of the regions of stream `number`. Raises WireError without one, RecordingError, OSError."""
        if not 0 <= number < len(self.streams):
            raise WireError(f"regions of stretch {number}; there are {len(self.streams)}")
        stream = self.streams[number]
        beside = [other for other in self.streams if other.sha256 == stream.sha256 and other.grid == stream.grid]
        kinds = [KINDS_VERSION, *sorted(map(_stretch_key, beside), key=str)]
        key = {"regions": _stretch_key(stream), "kinds": kinds}
        path = self._folder / f"{number}.regions.npz"
        return self._cache.fetch(key, path, lambda made: store_regions(stream, cell_kinds_for(stream, beside), made))

    def kinds(self, number: int) -> StoredKinds:
        """The kinds of the cells of stream `number`. Raises RecordingError, OSError."""
        return StretchRegions.read(self.regions(number)).kinds


def _recording_key(recording: Recording) -> dict[str, Any]:
    """Everything that the scans of a recording depend on."""
    return {
        "versions": [STRETCHES_VERSION, version("gridtrack"), recording.scans_version],
        "name": recording.name,
        "sha256": recording.sha256,
        "options": recording.options.model_dump(mode="json"),
    }


def _stretch_key(stream: GridStream) -> dict[str, Any]:
    """Everything that the frames of a stretch and the header of their file depend on."""
    return {
        "recording": _recording_key(stream.recording),
        "stretch": [stream.name, stream.start_s, len(stream)],
        "grid": str(stream.grid),
        "period_ns": stream.period_ns,
        "points": stream.points,
    }


def store_stretch(stream: GridStream, path: Path) -> Path:
    """Write the frames of `stream` and the classes of their occupied cells to `path`, without truth; returns `path`.

    The file is a series of wire messages, compressed: a header, and one message for each frame. Equal streams give
    equal files. Raises RecordingError, OSError.
    """
    header = {
        "stream": messages.stream_fields(stream_of(stream)),
        "name": stream.name,
        "sha256": stream.sha256,
        "frames": len(stream),
        "start_s": stream.start_s,
    }
    with atomic_write(path) as raw, gzip.GzipFile("", "wb", compresslevel=1, fileobj=raw, mtime=0) as file:
        file.writelines(encode(Message("stretch", 0, header)))
        for number, observation in enumerate(stream.observations(), start=1):
            cells, labels = labelled_returns(observation.scans, observation.grid_T_sensor, stream.grid)
            arrays = messages.frame_arrays(observation.frame) | {"cells": cells, "labels": labels}
            file.writelines(encode(Message("frame", number, {}, arrays)))
    return path


class StoredStretch:
    """A FrameSource that reads a file of `store_stretch`, with the members of a FrameSource and no others."""

    def __init__(self, path: Path, progress: Progress | None = None) -> None:
        """Reading is a stage of `progress`. Raises WireError, OSError."""
        with gzip.open(path, "rb") as file:
            header = receive(_fill_from(file), 0)
        stream = messages.stream_from(header)
        self.name = header.value("name", str)
        self.sha256 = header.value("sha256", str)
        self.grid = stream.grid
        self.period_s = stream.period_s
        self.site = stream.site
        self.classes = stream.classes
        self._frames = header.value("frames", int)
        self._start_s = header.value("start_s", float)
        self._path, self._progress = path, progress or Progress()

    def __len__(self) -> int:
        return self._frames

    def __iter__(self) -> Iterator[GridFrame]:
        return (messages.frame_from(message) for message in self._messages())

    def labelled(self) -> Iterator[LabelledFrame]:
        """The frames with the classes of their occupied cells. Raises RecordingError for a label without a class."""
        for number, message in enumerate(self._messages()):
            frame = messages.frame_from(message)
            cells, labels = message.array("cells", "int64", (None,)), message.array("labels", "uint8", (None,))
            check_labels(labels, self.classes, self._start_s + number * self.period_s)
            yield LabelledFrame(frame, cells, labels)

    def _messages(self) -> Iterator[Message]:
        # a cell has at most one label, of an int64 and a uint8
        limit = messages.update_limit(self.grid) + 9 * self.grid.size**2
        with gzip.open(self._path, "rb") as file:
            fill = _fill_from(file)
            receive(fill, 0)
            with self._progress.stage(f"{self.name}, frame", self._frames) as stage:
                for _ in range(self._frames):
                    yield receive(fill, limit)
                    stage.advance()


def _fill_from(file: IO[bytes] | gzip.GzipFile) -> Fill:
    """Reads of `file`. Raises EOFError if it ends inside a message."""

    def fill(buffers: list[memoryview]) -> None:
        for buffer in (b for b in buffers if b.nbytes):
            content = file.read(buffer.nbytes)
            if len(content) < buffer.nbytes:
                raise EOFError
            buffer[:] = content

    return fill
