"""Scans in the order of their stamps: several sensors merged, scans with an impossible stamp or pose left out."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterator

from gridtrack.common.errors import RecordingError
from gridtrack.common.scan import Scan

MAX_DELAY_NS = 1_000_000_000
MAX_STAMP_NS = 1 << 63
MAX_SENSORS = 255


class StampOrder:
    """Merges the sensors of a file by stamp. Scans wait for a second, since those of one sensor may be written late.

    The order of one sensor's scans in the file is taken as correct: a scan that is not stamped after the one before has
    a wrong stamp, and is left out. `warn` receives one line for each kind of fault and sensor, with the number of scans
    and the time of the first.
    """

    def __init__(self, warn: Callable[[str], None]) -> None:
        self._warn = warn
        self._waiting: list[tuple[int, int, Scan]] = []
        self._arrived = 0
        self._first_ns = 0
        self._newest_ns = -1
        self._yielded_ns = -1
        self._before: dict[str, Scan] = {}
        self._faults: dict[str, tuple[int, float]] = {}

    @property
    def empty(self) -> bool:
        """Whether no scan was pushed."""
        return self._arrived == 0

    def push(self, scan: Scan) -> Iterator[Scan]:
        """Add the next scan of the file, and yield the scans that no longer wait. Raises RecordingError."""
        if self.empty:
            self._first_ns = scan.stamp_ns
        self._arrived += 1
        if not self._accepts(scan):
            return
        self._newest_ns = max(self._newest_ns, scan.stamp_ns)
        heapq.heappush(self._waiting, (scan.stamp_ns, self._arrived, scan))
        while self._waiting[0][0] < self._newest_ns - MAX_DELAY_NS:
            self._yielded_ns = self._waiting[0][0]
            yield heapq.heappop(self._waiting)[2]

    def flush(self) -> Iterator[Scan]:
        """Yield the scans that still wait, and report the faults."""
        while self._waiting:
            yield heapq.heappop(self._waiting)[2]
        for fault, (count, first_s) in self._faults.items():
            self._warn(f"{fault}: {count} of them, the first {first_s:.3f} s after the first scan")

    def _accepts(self, scan: Scan) -> bool:
        """Whether the scan is kept. Raises RecordingError for an impossible geometry."""
        before = self._before.get(scan.sensor)
        if before is None:
            _check_scan(scan)
            if len(self._before) == MAX_SENSORS:
                raise RecordingError(f"more than {MAX_SENSORS} sensors; read one of them with a topic")
        elif scan.stamp_ns <= before.stamp_ns:
            self._fault(scan, "not stamped after the one before, left out")
            return False
        elif not _has_finite_pose(scan):
            self._fault(scan, "whose pose is not finite, left out")
            return False
        elif _geometry(scan) != _geometry(before) or scan.stamp_ns >= MAX_STAMP_NS:
            _check_scan(scan)
        if scan.stamp_ns < self._yielded_ns:
            self._fault(scan, "stamped more than a second before those of other sensors, left out")
            return False
        if before is not None and before.ranges.size != scan.ranges.size:
            self._fault(scan, "whose number of beams differs from the one before")
        self._before[scan.sensor] = scan
        return True

    def _fault(self, scan: Scan, what: str) -> None:
        text = f"scans of sensor '{scan.sensor}' {what}"
        count, first_s = self._faults.get(text, (0, (scan.stamp_ns - self._first_ns) / 1e9))
        self._faults[text] = (count + 1, first_s)


def _geometry(scan: Scan) -> tuple[float, float, float, float]:
    return scan.angle_min, scan.angle_increment, scan.range_min, scan.range_max


def _has_finite_pose(scan: Scan) -> bool:
    pose = scan.world_T_sensor
    return math.isfinite(pose.x) and math.isfinite(pose.y) and math.isfinite(pose.theta)


def _check_scan(scan: Scan) -> None:
    """Raise RecordingError for a stamp, geometry or pose that cannot be that of a scan."""
    if not 0 <= scan.stamp_ns < MAX_STAMP_NS:
        raise RecordingError(f"sensor '{scan.sensor}': a stamp of {scan.stamp_ns} ns; expected 0 to 2^63 ns")
    limits = f"range limits {scan.range_min:g} to {scan.range_max:g} m"
    if not (math.isfinite(scan.range_max) and 0.0 <= scan.range_min < scan.range_max):
        raise RecordingError(f"sensor '{scan.sensor}': {limits}; expected finite ones, the lower limit first")
    if not (math.isfinite(scan.angle_min) and math.isfinite(scan.angle_increment)):
        raise RecordingError(f"sensor '{scan.sensor}': beams from {scan.angle_min} every {scan.angle_increment} rad")
    if not _has_finite_pose(scan):
        p = scan.world_T_sensor
        raise RecordingError(
            f"sensor '{scan.sensor}': a pose of {p.x:g}, {p.y:g}, {p.theta:g}; expected finite numbers"
        )
