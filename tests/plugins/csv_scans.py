"""A recording format of another package, and formats with a bug: scans as lines of text."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gridtrack.common.scan import Scan
from gridtrack.recordings import ReadOptions, Recording, RecordingFormat
from gridtrack.recordings.recording import Topics


class CsvRecording(Recording):
    """One scan a line: the stamp in nanoseconds, then the ranges."""

    def read(self, topics: Topics) -> Iterator[Scan]:
        for line in self.path.read_text().splitlines()[1:]:
            stamp_ns, *ranges = line.split(",")
            topics.add("csv", "CSV", True)
            yield Scan(int(stamp_ns), np.array(ranges, np.float32), -math.pi, math.pi / 90, 0.05, 30.0)


def recognises(path: Path, head: bytes) -> bool:
    return head.startswith(b"scans")


def recognises_with_a_bug(path: Path, head: bytes) -> bool:
    return bool(head[99])


def open_with_a_bug(path: Path, options: ReadOptions) -> Recording:
    raise ValueError("no header")


FORMAT = RecordingFormat("CSV of scans", (".csv",), recognises, CsvRecording, options=())
FORGETFUL = RecordingFormat("forgetful", (".bug",), recognises_with_a_bug, CsvRecording)
UNOPENABLE = RecordingFormat("unopenable", (".csv",), recognises, open_with_a_bug)
NO_FORMAT = CsvRecording
