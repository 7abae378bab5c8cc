"""Scans put in the order of their stamps: several sensors merged, stragglers sorted in, impossible scans told."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterator

from gridtrack.common.errors import RecordingError
from gridtrack.common.scan import Scan

WINDOW_NS = 1_000_000_000
MAX_STAMP_NS = 1 << 63
MAX_SENSORS = 255


class StampOrder:
    """Holds scans back for a second of stamps, so that one that comes late still finds its place.

    What is wrong with the scans goes to `complain`, one line for each kind and sensor with its count and first place.
    """

    def __init__(self, complain: Callable[[str], None]) -> None:
        self._complain = complain
        self._waiting: list[tuple[int, int, Scan]] = []
        self._arrived = 0
        self._first_ns = 0
        self._newest_ns = -1
        self._given_ns = -1
        self._given_of: dict[str, int] = {}
        self._before: dict[str, Scan] = {}
        self._faults: dict[str, tuple[int, float]] = {}

    @property
    def empty(self) -> bool:
        """Whether no scan has come at all."""
        return self._arrived == 0

    def push(self, scan: Scan) -> Iterator[Scan]:
        """Take in the next scan of the file, and give those whose turn has come. Raises RecordingError."""
        if self.empty:
            self._first_ns = scan.stamp_ns
        self._arrived += 1
        self._check(scan)
        if scan.stamp_ns < self._given_ns:
            self._fault(scan, "stamped more than a second before others that came earlier, left out")
            return
        self._newest_ns = max(self._newest_ns, scan.stamp_ns)
        heapq.heappush(self._waiting, (scan.stamp_ns, self._arrived, scan))
        while self._waiting[0][0] < self._newest_ns - WINDOW_NS:
            yield from self._give()

    def flush(self) -> Iterator[Scan]:
        """Give what is still held back, and tell what was wrong."""
        while self._waiting:
            yield from self._give()
        for fault, (count, where_s) in self._faults.items():
            self._complain(f"{fault}: {count} of them, the first {where_s:.3f} s after the first scan")

    def _give(self) -> Iterator[Scan]:
        scan = heapq.heappop(self._waiting)[2]
        if self._given_of.get(scan.sensor) == scan.stamp_ns:
            self._fault(scan, "with the stamp of the one before, left out")
            return
        self._given_ns = self._given_of[scan.sensor] = scan.stamp_ns
        yield scan

    def _check(self, scan: Scan) -> None:
        if not 0 <= scan.stamp_ns < MAX_STAMP_NS:
            raise RecordingError(f"sensor '{scan.sensor}': a stamp of {scan.stamp_ns} ns; expected 0 to 2^63 ns")
        before = self._before.get(scan.sensor)
        if before is None:
            _refuse_impossible(scan)
            if len(self._before) == MAX_SENSORS:
                raise RecordingError(f"more than {MAX_SENSORS} sensors; read one of them with a topic")
        else:
            if before.range_max != scan.range_max or before.angle_increment != scan.angle_increment:
                _refuse_impossible(scan)
            if before.ranges.size != scan.ranges.size:
                self._fault(scan, "whose number of beams differs from the one before")
            if scan.stamp_ns < before.stamp_ns:
                self._fault(scan, "stamped before the one that they follow, put in order")
        self._before[scan.sensor] = scan

    def _fault(self, scan: Scan, what: str) -> None:
        text = f"scans of sensor '{scan.sensor}' {what}"
        count, where_s = self._faults.get(text, (0, (scan.stamp_ns - self._first_ns) / 1e9))
        self._faults[text] = (count + 1, where_s)


def _refuse_impossible(scan: Scan) -> None:
    """Raise RecordingError for a scan whose geometry means nothing."""
    limits = f"range limits {scan.range_min:g} to {scan.range_max:g} m"
    if not (math.isfinite(scan.range_max) and 0.0 <= scan.range_min < scan.range_max):
        raise RecordingError(f"sensor '{scan.sensor}': {limits}; expected finite ones, the lower first")
    if not (math.isfinite(scan.angle_min) and math.isfinite(scan.angle_increment)):
        raise RecordingError(f"sensor '{scan.sensor}': beams from {scan.angle_min} every {scan.angle_increment} rad")
