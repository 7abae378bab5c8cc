"""Scans in memory as a recording."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from gridtrack.common.scan import Scan
from gridtrack.recordings import ReadOptions, Recording
from gridtrack.recordings.recording import Topics


class HeldRecording(Recording):
    """Scans in place of those of a file: nothing is read or decoded. Metadata and hash are those of the `origin`."""

    def __init__(self, held: Sequence[Scan], origin: Recording) -> None:
        super().__init__(origin.path, ReadOptions())
        self.held, self.info = held, origin.info

    def read(self, topics: Topics) -> Iterator[Scan]:
        """The scans."""
        topics.add("scan", "held", is_scan=True)
        return iter(self.held)
