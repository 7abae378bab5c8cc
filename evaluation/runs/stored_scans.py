"""Scans of the frames of a training as arrays: where the sensor moves, later frames are cast into earlier windows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2
from gridtrack.common.scan import Scan
from gridtrack.recordings.observation import reference_pose


class ScansWriter:
    """Collects the scans of frames, without labels and truth."""

    def __init__(self) -> None:
        self._counts: list[int] = []
        self._ranges: list[NDArray[np.float32]] = []
        self._geometry: list[tuple[float, ...]] = []

    def add(self, scans: tuple[Scan, ...]) -> None:
        """Add the scans of the next frame."""
        self._counts.append(len(scans))
        for scan in scans:
            pose = reference_pose(scan)
            self._ranges.append(scan.ranges)
            self._geometry.append(
                (scan.angle_min, scan.angle_increment, scan.range_min, scan.range_max, pose.x, pose.y, pose.theta)
            )

    def arrays(self) -> dict[str, Any]:
        """The arrays of `StoredScans.read`."""
        return {
            "scan_starts": np.cumsum([0, *self._counts]),
            "range_starts": np.cumsum([0, *map(len, self._ranges)]),
            "ranges": np.concatenate([np.zeros(0, np.float32), *self._ranges]),
            "geometry": np.array(self._geometry, np.float64).reshape(-1, 7),
        }


@dataclass(frozen=True, slots=True)
class StoredScans:
    """The scans of frame n are `scan_starts[n]` to `scan_starts[n + 1]`.

    Scan s has `ranges[range_starts[s] : range_starts[s + 1]]`, and in `geometry` (S, 7) float64 the angle of its first
    beam, that between beams, its range limits, and its reference pose.
    """

    scan_starts: NDArray[np.int64]
    range_starts: NDArray[np.int64]
    ranges: NDArray[np.float32]
    geometry: NDArray[np.float64]

    @classmethod
    def read(cls, stored: Mapping[str, NDArray[Any]]) -> Self:
        """From the arrays of `ScansWriter.arrays`."""
        return cls(stored["scan_starts"], stored["range_starts"], stored["ranges"], stored["geometry"])

    def of(self, frame: int, stamp_ns: int) -> tuple[Scan, ...]:
        """The scans of a frame by its number, with this stamp, at their reference poses."""
        return tuple(self._scan(s, stamp_ns) for s in range(self.scan_starts[frame], self.scan_starts[frame + 1]))

    def _scan(self, s: int, stamp_ns: int) -> Scan:
        ranges = self.ranges[self.range_starts[s] : self.range_starts[s + 1]]
        angle_min, step, range_min, range_max, *pose = self.geometry[s].tolist()
        return Scan(stamp_ns, ranges, angle_min, step, range_min, range_max, world_T_sensor=SE2(*pose))
