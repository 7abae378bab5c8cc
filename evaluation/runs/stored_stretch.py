"""Stretches as files of frames: what a training process receives of a recording."""

from __future__ import annotations

import gzip
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from gridtrack.common.grid import GridFrame, LabelledFrame
from gridtrack.recordings.cell_labels import check_labels, labelled_returns
from gridtrack.recordings.stream import GridStream
from gridtrack.trackers import messages
from gridtrack.trackers.contract import stream_of
from gridtrack.trackers.progress import Progress
from gridtrack.trackers.wire import Fill, Message, encode, receive


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
    with path.open("wb") as raw, gzip.GzipFile("", "wb", compresslevel=1, fileobj=raw, mtime=0) as file:
        file.writelines(encode(Message("stretch", 0, header)))
        for number, observation in enumerate(stream.observations(), start=1):
            cells, labels = labelled_returns(observation.scans, observation.grid_T_sensor, stream.grid)
            arrays = messages.frame_arrays(observation.frame) | {"cells": cells, "labels": labels}
            file.writelines(encode(Message("frame", number, {}, arrays)))
    return path


class StoredStretch:
    """A FrameSource that reads the file of `store_stretch`; it has the members of a FrameSource and nothing else."""

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
    """Reads of `file`. Raises EOFError where it ends inside a message."""

    def fill(buffers: list[memoryview]) -> None:
        for buffer in (b for b in buffers if b.nbytes):
            content = file.read(buffer.nbytes)
            if len(content) < buffer.nbytes:
                raise EOFError
            buffer[:] = content

    return fill
