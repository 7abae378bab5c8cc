"""Poses between the poses of scans."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gridtrack.common.geometry import SE2, wrap_angle


class InterpolatedPoses:
    """Poses at any stamp: position and heading are linear between two scans, constant outside."""

    def __init__(self, stamps_ns: Sequence[int], poses: Sequence[SE2]) -> None:
        """`poses` at `stamps_ns`, which increase."""
        self._stamps_ns = np.array(stamps_ns, np.int64)
        self._x, self._y, theta = np.array([(pose.x, pose.y, pose.theta) for pose in poses]).T
        self._theta = np.unwrap(theta)

    def at(self, stamp_ns: int) -> SE2:
        """The pose at a stamp."""
        after = int(np.searchsorted(self._stamps_ns, stamp_ns))
        near = slice(max(after - 1, 0), after + 1)
        # relative to the stamp: seconds since 1970 as floats have a resolution of a microsecond
        since_s = (self._stamps_ns[near] - stamp_ns) / 1e9
        x, y, theta = (float(np.interp(0.0, since_s, values[near])) for values in (self._x, self._y, self._theta))
        return SE2(x, y, wrap_angle(theta))
