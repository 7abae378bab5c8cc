"""Damaged stamps of one sensor, recognised by the stamps of the neighbouring scans in the file."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations, pairwise

from gridtrack.common.scan import Scan

JUMP_PERIODS = 3
"""A scan later than this many periods is held until the scans after it show whether its stamp is correct."""
CONFIRMING_SCANS = 3
"""So many scans in a row at a later time are a gap; fewer, with earlier scans after them, have damaged stamps."""
FAR_NS, FAR_PERIODS = 10_000_000_000, 10
"""The first or the last scan of a sensor is damaged where it is further than both from its only neighbour."""
NOT_AFTER = "not stamped after the one before, left out"
FAR_OFF = "whose stamp is far from those before and after, left out"


class StampFilter:
    """Leaves out the scans of one sensor whose stamps are damaged; holds three scans at most.

    The order of the scans in the file is taken as correct. A scan stamped later than those after it is damaged, and a
    scan not stamped after the one before is, too. A stamp ahead of the one before is a gap where the scans after it are
    later still. `fault` receives each scan that is left out, the reason, and its time in the recording, ns.
    """

    def __init__(self, fault: Callable[[Scan, str, int], None]) -> None:
        self._fault = fault
        self._last_ns: int | None = None
        self._period_ns = 0
        self._held: list[Scan] = []

    def push(self, scan: Scan) -> list[Scan]:
        """The scans whose stamps are correct, in order, now that `scan` is the next one of the file."""
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
        """The scans that are held, without a wait for the scans after them."""
        accepted = self._start() if self._last_ns is None else []
        held, self._held = self._held, []
        return accepted + self._accept(held)

    def flush(self) -> list[Scan]:
        """The scans that are held at the end of the file, without a last one far after the one before."""
        accepted = self._start() if self._last_ns is None else []
        far_ns = max(FAR_NS, FAR_PERIODS * self._period_ns)
        if self._held and self._held[-1].stamp_ns - self._before_newest_ns() > far_ns:
            self._leave_out_newest_held()
        return accepted + self.release()

    def _start(self) -> list[Scan]:
        """The first scans: all where they are in order, else the two of them that are closest in time."""
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
        """The first scan held, and those of the others that follow it closely."""
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
        """The stamp before that of the newest scan held."""
        assert self._last_ns is not None
        return self._held[-2].stamp_ns if len(self._held) > 1 else self._last_ns
