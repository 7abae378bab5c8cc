"""The poses of all sensors of a robot from tick to tick, also of those that have no scan."""

from __future__ import annotations

from collections.abc import Mapping

from gridtrack.common.geometry import SE2
from gridtrack.common.scan import Scan


class SensorPoses:
    """The pose of every sensor, `world_T_sensor`, at its scan; one without a scan is carried along by the others.

    The sensors are taken to be on one robot: one without a scan moves as the first one that has a scan, and had one
    before. Until then it stays at the pose of its first scan.
    """

    def __init__(self, first: Mapping[str, SE2]) -> None:
        """`first`: the pose of each sensor at its first scan."""
        self._poses = dict(first)
        self._seen: set[str] = set()

    def at(self, scans: Mapping[str, Scan]) -> Mapping[str, SE2]:
        """The poses at the next tick, which has these scans by sensor."""
        leader = next((sensor for sensor in self._poses if sensor in scans and sensor in self._seen), None)
        if leader is not None:
            self._carry(self._seen - scans.keys(), self._poses[leader], scans[leader].world_T_sensor)
        self._poses.update({sensor: scan.world_T_sensor for sensor, scan in scans.items()})
        self._seen.update(scans)
        return dict(self._poses)

    def _carry(self, sensors: set[str], before: SE2, now: SE2) -> None:
        """Move `sensors` as one that was at `before` and is at `now`."""
        if now == before:
            return  # not by the rounding of its inverse
        moved = now @ before.inverse()
        self._poses.update({sensor: moved @ self._poses[sensor] for sensor in sensors})
