"""Scans at a fixed period: the nearest scan and the pose of each sensor for every tick."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from gridtrack.common.geometry import SE2
from gridtrack.common.scan import Scan

JITTER_PERIODS = 1.5
"""Limit of the jitter: a longer time between two scans is a missing scan."""


@dataclass(frozen=True, slots=True)
class Tick:
    """One instant of a stream with the scan of each sensor; a sensor in a long gap has none."""

    stamp_ns: int
    scans: dict[str, Scan]


def resample_scans(
    scans: Iterable[Scan], period_ns: int, *, origin_ns: int, ticks: Iterable[int], bridged: bool = True
) -> Iterator[Tick]:
    """Ticks at `origin_ns + k * period_ns` for k in `ticks`, from `scans` in the order of their stamps.

    A tick has the nearest scan of each sensor, the earlier of two equally near ones. The scan must be within half a
    period of the tick, or the gap around the tick must be short: at most JITTER_PERIODS (no scan is missing), or, where
    gaps are `bridged`, two periods (a neighbour replaces one missing scan). Memory holds a few periods of scans.
    """
    ahead = iter(scans)
    recent: dict[str, deque[Scan]] = {}
    newest_ns = -1
    for k in ticks:
        stamp_ns = origin_ns + k * period_ns
        while newest_ns <= stamp_ns + 2 * period_ns and (scan := next(ahead, None)) is not None:
            newest_ns = scan.stamp_ns
            if newest_ns >= stamp_ns - 2 * period_ns:
                recent.setdefault(scan.sensor, deque()).append(scan)
        for known in recent.values():
            while known and known[0].stamp_ns < stamp_ns - 2 * period_ns:
                known.popleft()
        chosen = {sensor: _nearest(known, stamp_ns, period_ns, bridged) for sensor, known in recent.items()}
        yield Tick(stamp_ns, {sensor: scan for sensor, scan in chosen.items() if scan is not None})


def _nearest(scans: deque[Scan], stamp_ns: int, period_ns: int, bridged: bool) -> Scan | None:
    """The scan of one sensor for the tick at `stamp_ns`, from its scans around it."""
    before = [scan for scan in scans if scan.stamp_ns <= stamp_ns][-1:]
    after = [scan for scan in scans if scan.stamp_ns > stamp_ns][:1]
    if not before and not after:
        return None
    nearest = min(before + after, key=lambda scan: abs(scan.stamp_ns - stamp_ns))
    if 2 * abs(nearest.stamp_ns - stamp_ns) <= period_ns:
        return nearest
    longest_ns = (2.0 if bridged else JITTER_PERIODS) * period_ns
    short = bool(before and after) and after[0].stamp_ns - before[0].stamp_ns <= longest_ns
    return nearest if short else None


class SensorPoses:
    """The pose `world_T_sensor` of every sensor at each tick, also of sensors without a scan.

    The sensors are assumed to be on one robot: a sensor without a scan moves like the first sensor that has a scan, and
    had one before. Until its own first scan it stays at the pose of that scan.
    """

    def __init__(self, first: Mapping[str, SE2]) -> None:
        """`first` is the pose of each sensor at its first scan."""
        self._poses = dict(first)
        self._seen: set[str] = set()

    def at(self, scans: Mapping[str, Scan]) -> Mapping[str, SE2]:
        """The poses at the next tick with these scans by sensor."""
        leader = next((sensor for sensor in self._poses if sensor in scans and sensor in self._seen), None)
        if leader is not None:
            self._carry(self._seen - scans.keys(), self._poses[leader], scans[leader].world_T_sensor)
        self._poses.update({sensor: scan.world_T_sensor for sensor, scan in scans.items()})
        self._seen.update(scans)
        return dict(self._poses)

    def _carry(self, sensors: set[str], before: SE2, now: SE2) -> None:
        """Move `sensors` like a sensor that moved from `before` to `now`."""
        if now == before:
            return  # the rounding of the inverse would move them
        moved = now @ before.inverse()
        self._poses.update({sensor: moved @ self._poses[sensor] for sensor in sensors})
