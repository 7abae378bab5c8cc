"""Scans in the order of their stamps: sensors merged, scans with damaged stamps or poses left out."""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import combinations, pairwise

from gridtrack.common.errors import RecordingError
from gridtrack.common.files import LABEL_RULE, is_label
from gridtrack.common.geometry import SE2
from gridtrack.common.scan import MAX_ANGLE_RAD, MAX_BEAMS, MAX_POSITION_M, MAX_RANGE_M, Scan

MAX_DELAY_NS = 1_000_000_000
MAX_STAMP_NS = 1 << 63
MAX_SENSORS = 255
JUMP_PERIODS = 3
"""A scan that comes later than this many periods is held until later scans show whether its stamp is correct."""
CONFIRMING_SCANS = 3
"""This many successive scans at a later time are a gap; fewer, with earlier scans after them, have damaged stamps."""
FAR_NS, FAR_PERIODS = 10_000_000_000, 10
"""The first or last scan of a sensor is damaged if it is further than both from its only neighbour."""
BEAMS_OFF, ANGLE_ROUNDING = 1.5, 1e-3
"""Limits of the contradiction between the angles of a header: in beams, and as a share of the field of view."""
MANY_ALIKE = 0.1
"""Share of scans with stamps not after the one before, from which the stamps as a whole are in question."""
NOT_AFTER = "not stamped after the one before, left out"
FAR_OFF = "with a stamp far from the neighbouring ones, left out"


class StampFilter:
    """Leaves out scans of one sensor with damaged stamps; holds three scans at most.

    The order of the scans in the file counts as correct. A stamp is damaged if it is later than the following ones, or
    not after the preceding one. A jump ahead is a gap if the following stamps are later still. `fault` receives each
    scan that is left out, the reason, and its time in the recording, ns.
    """

    def __init__(self, fault: Callable[[Scan, str, int], None]) -> None:
        self._fault = fault
        self._last_ns: int | None = None
        self._period_ns = 0
        self._held: list[Scan] = []

    def push(self, scan: Scan) -> list[Scan]:
        """Add the next scan of the file; returns the scans that are now known to be correct, in order."""
        if self._last_ns is None:
            self._held.append(scan)
            return self._start() if len(self._held) == CONFIRMING_SCANS else []
        if scan.stamp_ns <= self._last_ns:
            return self._leave_out(scan)
        while self._held and scan.stamp_ns < self._held[-1].stamp_ns:
            self._leave_out_newest_held()
        if self._held and scan.stamp_ns == self._held[-1].stamp_ns:
            return self._leave_out(scan)
        if not self._held and scan.stamp_ns - self._last_ns <= JUMP_PERIODS * self._period_ns:
            return self._accept([scan])
        self._held.append(scan)
        return self._confirm() if len(self._held) == CONFIRMING_SCANS else []

    def held_before(self, stamp_ns: int) -> bool:
        """Whether a scan is held that is stamped before `stamp_ns`."""
        return any(scan.stamp_ns < stamp_ns for scan in self._held)

    def release(self) -> list[Scan]:
        """The held scans, without waiting for later ones."""
        accepted = self._start() if self._last_ns is None else []
        held, self._held = self._held, []
        return accepted + self._accept(held)

    def flush(self) -> list[Scan]:
        """The held scans at the end of the file, without a last one that is far off."""
        accepted = self._start() if self._last_ns is None else []
        far_ns = max(FAR_NS, FAR_PERIODS * self._period_ns)
        if self._held and self._held[-1].stamp_ns - self._before_newest_ns() > far_ns:
            self._leave_out_newest_held()
        return accepted + self.release()

    def _start(self) -> list[Scan]:
        """The first scans: all if they are in order, else the two that are closest in time."""
        held, self._held = self._held, []
        periods = [after.stamp_ns - before.stamp_ns for before, after in pairwise(held)]
        kept = held
        if any(period <= 0 for period in periods):
            pairs = [pair for pair in combinations(held, 2) if pair[0].stamp_ns < pair[1].stamp_ns]
            kept = list(min(pairs, key=lambda pair: pair[1].stamp_ns - pair[0].stamp_ns, default=held[:1]))
        elif len(periods) > 1 and periods[0] > max(FAR_NS, FAR_PERIODS * periods[1]):
            kept = held[1:]
        position_ns = kept[0].stamp_ns if kept else 0
        for scan in held:
            if not any(scan is other for other in kept):
                near = abs(scan.stamp_ns - position_ns) <= FAR_NS
                self._fault(scan, NOT_AFTER if near else FAR_OFF, position_ns)
        accepted = self._accept(kept[:2])
        return accepted + [found for scan in kept[2:] for found in self.push(scan)]

    def _confirm(self) -> list[Scan]:
        """The first held scan, and others that follow it closely."""
        (first, *others), self._held = self._held, []
        accepted = self._accept([first])
        return accepted + [found for scan in others for found in self.push(scan)]

    def _accept(self, scans: list[Scan]) -> list[Scan]:
        for scan in scans:
            if self._last_ns is not None:
                since_ns = scan.stamp_ns - self._last_ns
                self._period_ns = min(since_ns, JUMP_PERIODS * self._period_ns) if self._period_ns else since_ns
            self._last_ns = scan.stamp_ns
        return scans

    def _leave_out(self, scan: Scan) -> list[Scan]:
        assert self._last_ns is not None
        near = scan.stamp_ns > self._last_ns - FAR_NS
        self._fault(scan, NOT_AFTER, scan.stamp_ns if near else self._last_ns)
        return []

    def _leave_out_newest_held(self) -> None:
        at_ns = self._before_newest_ns()
        self._fault(self._held.pop(), FAR_OFF, at_ns)

    def _before_newest_ns(self) -> int:
        """The stamp before the newest held scan."""
        assert self._last_ns is not None
        return self._held[-2].stamp_ns if len(self._held) > 1 else self._last_ns


class StampOrder:
    """Merges the sensors of a file by stamp. Scans wait for a second, since a sensor's scans may be written late.

    Scans with a damaged stamp are left out (StampFilter). `warn` receives one line for each kind of fault and sensor,
    with the number of scans and the time of the first.
    """

    def __init__(self, warn: Callable[[str], None], remedy: Callable[[], str] = str) -> None:
        """`remedy()`: the remedy for many stamps that are alike or in disorder, asked at the end of the file."""
        self._warn, self._remedy = warn, remedy
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
        """Yield the waiting scans, and report the faults. Raises RecordingError if all scans are faulty."""
        for stamps in self._filters.values():
            self._add(stamps.flush())
        while self._waiting:
            yield heapq.heappop(self._waiting)[2]
        for fault, (count, at_ns) in self._faults.items():
            first_s = max(at_ns - (self._first_ns or 0), 0) / 1e9
            text = f"{fault}: {count} of them, the first {first_s:.3f} s after the first scan"
            if NOT_AFTER in fault and count > MANY_ALIKE * self._pushed and (remedy := self._remedy()):
                text += f"; {count / self._pushed:.0%} of the stamps are alike or in disorder: {remedy}"
            self._warn(text)
        if self._first_ns is None and self._faults:
            raise RecordingError(f"no scan can be used: {next(iter(self._faults))}")

    def _add(self, scans: Iterable[Scan]) -> None:
        """Let the accepted `scans` wait. Raises RecordingError for an impossible geometry."""
        for scan in map(self._with_finite_range, scans):
            if self._accepts(scan):
                self._first_ns = scan.stamp_ns if self._first_ns is None else min(self._first_ns, scan.stamp_ns)
                self._newest_ns = max(self._newest_ns, scan.stamp_ns)
                heapq.heappush(self._waiting, (scan.stamp_ns, next(self._numbers), scan))

    def _with_finite_range(self, scan: Scan) -> Scan:
        """The scan; an infinite range_max, as `pointcloud_to_laserscan` writes it, becomes MAX_RANGE_M."""
        if scan.range_max != math.inf:
            return scan
        self._fault(scan, f"with an infinite range_max, taken as {MAX_RANGE_M:g} m", scan.stamp_ns)
        return replace(scan, range_max=MAX_RANGE_M)

    def _accepts(self, scan: Scan) -> bool:
        before = self._before.get(scan.sensor)
        if before is not None and _invalid_pose(scan) is not None:
            self._fault(scan, "with a pose that is not finite, left out", scan.stamp_ns)
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
            self._fault(scan, "with another number of beams than the one before", scan.stamp_ns)
        self._before[scan.sensor] = scan
        return True

    def _fault(self, scan: Scan, fault: str, at_ns: int) -> None:
        text = f"scans of sensor '{scan.sensor}' {fault}"
        count, first_ns = self._faults.get(text, (0, at_ns))
        self._faults[text] = (count + 1, first_ns)


def _geometry(scan: Scan) -> tuple[float | None, ...]:
    angles = (scan.angle_min, scan.angle_increment, scan.last_angle)
    return (*angles, scan.range_min, scan.range_max, scan.ranges.size)


def _contradiction_of(scan: Scan) -> str:
    """Why the angles of a scan contradict each other, and what to do; else empty.

    Drivers count one beam more, or one less.
    """
    steps = scan.ranges.size - 1
    counted_rad = scan.angle_increment * steps
    declared_rad = counted_rad if scan.last_angle is None else scan.last_angle - scan.angle_min
    off_rad = abs(declared_rad - counted_rad)
    fits = off_rad <= BEAMS_OFF * abs(scan.angle_increment) + ANGLE_ROUNDING * abs(declared_rad)
    if steps < 1 or (fits and scan.angle_increment != 0.0):
        return ""
    first, declared, counted = (math.degrees(angle) for angle in (scan.angle_min, declared_rad, counted_rad))
    return (
        f"its header contradicts itself: {steps + 1} beams every {scan.angle_increment:g} rad cover {counted:.4g} deg,"
        f" and angle_max is {declared:.4g} deg from angle_min: import the recording with the angles of the first and"
        f" the last beam, as in --angles {first:.5g}deg,{first + declared if declared else first + 180.0:.5g}deg"
    )


def _invalid_pose(scan: Scan) -> SE2 | None:
    """The first of the scan's poses that is not finite or too far away."""
    for pose in (scan.world_T_sensor, scan.reference_T_sensor):
        if pose is not None and not (
            abs(pose.x) <= MAX_POSITION_M and abs(pose.y) <= MAX_POSITION_M and math.isfinite(pose.theta)
        ):
            return pose
    return None


def _problem_of(scan: Scan) -> str:
    """The reason why the geometry or the pose of a scan is impossible; else empty."""
    beams = scan.ranges.size
    if not 0.0 <= scan.range_min < scan.range_max <= MAX_RANGE_M:
        return (
            f"range limits {scan.range_min:g} to {scan.range_max:g} m; expected finite limits up to {MAX_RANGE_M:g} m,"
            " the lower one first: import the recording with those of the laser, --range-limits MIN,MAX"
        )
    if beams > MAX_BEAMS:
        return f"{beams} beams; at most {MAX_BEAMS}"
    extent = abs(scan.angle_increment) * max(beams - 1, 1)
    if not (abs(scan.angle_min) <= MAX_ANGLE_RAD and extent <= MAX_ANGLE_RAD):
        return (
            f"{beams} beams from {scan.angle_min:g} rad every {scan.angle_increment:g} rad; expected radians, and at"
            f" most two turns ({MAX_ANGLE_RAD:.4g} rad): import the recording with those of the first and the"
            " last beam, --angles FIRST,LAST"
        )
    if contradiction := _contradiction_of(scan):
        return contradiction
    if (p := _invalid_pose(scan)) is not None:
        return f"a pose of {p.x:g}, {p.y:g}, {p.theta:g}; expected finite numbers, and at most {MAX_POSITION_M:g} m"
    return ""
