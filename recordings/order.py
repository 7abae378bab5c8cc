"""Scans in the order of their stamps: several sensors merged, scans with a damaged stamp or pose left out."""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

from gridtrack.common.errors import RecordingError
from gridtrack.common.geometry import SE2
from gridtrack.common.names import LABEL_RULE, is_label
from gridtrack.common.scan import MAX_ANGLE_RAD, MAX_BEAMS, MAX_POSITION_M, MAX_RANGE_M, Scan
from gridtrack.recordings.stamp_filter import StampFilter

MAX_DELAY_NS = 1_000_000_000
MAX_STAMP_NS = 1 << 63
MAX_SENSORS = 255


class StampOrder:
    """Merges the sensors of a file by stamp. Scans wait for a second, since those of one sensor may be written late.

    Scans with a damaged stamp are left out (StampFilter). `warn` receives one line for each kind of fault and sensor,
    with the number of scans and the time of the first.
    """

    def __init__(self, warn: Callable[[str], None]) -> None:
        self._warn = warn
        self._waiting: list[tuple[int, int, Scan]] = []
        self._numbers = itertools.count()
        self._pushed = 0
        self._first_ns: int | None = None
        self._newest_ns = -1
        self._yielded_ns = -1
        self._filters: dict[str, StampFilter] = {}
        self._before: dict[str, Scan] = {}
        self._faults: dict[str, tuple[int, int]] = {}

    @property
    def empty(self) -> bool:
        """Whether no scan was pushed."""
        return self._pushed == 0

    def push(self, scan: Scan) -> Iterator[Scan]:
        """Add the next scan of the file, and yield the scans that no longer wait. Raises RecordingError."""
        self._pushed += 1
        if not 0 <= scan.stamp_ns < MAX_STAMP_NS:
            self._fault(scan, "stamped outside 0 to 2^63 ns, left out", self._newest_ns)
            return
        if scan.sensor not in self._filters:
            if len(self._filters) == MAX_SENSORS:
                raise RecordingError(f"more than {MAX_SENSORS} sensors; read one of them with a topic")
            if scan.sensor and not is_label(scan.sensor):
                raise RecordingError(f"sensor {scan.sensor[:40]!r}: {LABEL_RULE}")
            self._filters[scan.sensor] = StampFilter(self._fault)
        self._add(self._filters[scan.sensor].push(scan))
        due_ns = self._newest_ns - MAX_DELAY_NS
        for stamps in self._filters.values():
            if stamps.held_before(due_ns):
                self._add(stamps.release())
        while self._waiting and self._waiting[0][0] < self._newest_ns - MAX_DELAY_NS:
            self._yielded_ns = self._waiting[0][0]
            yield heapq.heappop(self._waiting)[2]

    def flush(self) -> Iterator[Scan]:
        """Yield the scans that still wait, and report the faults. Raises RecordingError where every scan has one."""
        for stamps in self._filters.values():
            self._add(stamps.flush())
        while self._waiting:
            yield heapq.heappop(self._waiting)[2]
        for fault, (count, at_ns) in self._faults.items():
            first_s = max(at_ns - (self._first_ns or 0), 0) / 1e9
            self._warn(f"{fault}: {count} of them, the first {first_s:.3f} s after the first scan")
        if self._first_ns is None and self._faults:
            raise RecordingError(f"no scan can be used: {next(iter(self._faults))}")

    def _add(self, scans: Iterable[Scan]) -> None:
        """Let `scans` wait that are accepted. Raises RecordingError for an impossible geometry."""
        for scan in map(self._with_finite_range, scans):
            if self._accepts(scan):
                self._first_ns = scan.stamp_ns if self._first_ns is None else min(self._first_ns, scan.stamp_ns)
                self._newest_ns = max(self._newest_ns, scan.stamp_ns)
                heapq.heappush(self._waiting, (scan.stamp_ns, next(self._numbers), scan))

    def _with_finite_range(self, scan: Scan) -> Scan:
        """A scan whose range has no end, as `pointcloud_to_laserscan` writes it, with the largest one that there is."""
        if scan.range_max != math.inf:
            return scan
        self._fault(scan, f"whose range_max is infinite, taken as {MAX_RANGE_M:g} m", scan.stamp_ns)
        return replace(scan, range_max=MAX_RANGE_M)

    def _accepts(self, scan: Scan) -> bool:
        before = self._before.get(scan.sensor)
        if before is not None and _invalid_pose(scan) is not None:
            self._fault(scan, "whose pose is not finite, left out", scan.stamp_ns)
            return False
        if before is None or _geometry(scan) != _geometry(before):
            problem = _problem_of(scan)
            if problem and before is None:
                raise RecordingError(f"sensor '{scan.sensor}': {problem}")
            if problem:
                self._fault(scan, "with impossible range limits, angles or number of beams, left out", scan.stamp_ns)
                return False
        if scan.stamp_ns < self._yielded_ns:
            self._fault(scan, "stamped more than a second before those of other sensors, left out", scan.stamp_ns)
            return False
        if before is not None and before.ranges.size != scan.ranges.size:
            self._fault(scan, "whose number of beams differs from the one before", scan.stamp_ns)
        self._before[scan.sensor] = scan
        return True

    def _fault(self, scan: Scan, what: str, at_ns: int) -> None:
        text = f"scans of sensor '{scan.sensor}' {what}"
        count, first_ns = self._faults.get(text, (0, at_ns))
        self._faults[text] = (count + 1, first_ns)


def _geometry(scan: Scan) -> tuple[float, float, float, float, int]:
    return scan.angle_min, scan.angle_increment, scan.range_min, scan.range_max, scan.ranges.size


def _invalid_pose(scan: Scan) -> SE2 | None:
    """The one of the scan's poses that cannot be that of a sensor."""
    for pose in (scan.world_T_sensor, scan.reference_T_sensor):
        if pose is not None and not (
            abs(pose.x) <= MAX_POSITION_M and abs(pose.y) <= MAX_POSITION_M and math.isfinite(pose.theta)
        ):
            return pose
    return None


def _problem_of(scan: Scan) -> str:
    """What of the geometry or the pose cannot be that of a scan; empty where it can."""
    beams = scan.ranges.size
    if not 0.0 <= scan.range_min < scan.range_max <= MAX_RANGE_M:
        return (
            f"range limits {scan.range_min:g} to {scan.range_max:g} m; expected finite ones up to {MAX_RANGE_M:g} m,"
            " the lower limit first"
        )
    if beams > MAX_BEAMS:
        return f"{beams} beams; at most {MAX_BEAMS}"
    extent = abs(scan.angle_increment) * max(beams - 1, 1)
    if not (abs(scan.angle_min) <= MAX_ANGLE_RAD and extent <= MAX_ANGLE_RAD):
        return (
            f"{beams} beams from {scan.angle_min:g} rad every {scan.angle_increment:g} rad; expected radians, and at"
            f" most two turns ({MAX_ANGLE_RAD:.4g} rad)"
        )
    if (p := _invalid_pose(scan)) is not None:
        return f"a pose of {p.x:g}, {p.y:g}, {p.theta:g}; expected finite numbers, and at most {MAX_POSITION_M:g} m"
    return ""
