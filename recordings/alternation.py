"""Two lasers on one topic with one frame: their scans alternate between two views.

The messages do not distinguish them, but a scan is like the last one of its own laser.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.scan import Scan

UNLIKE_M = 0.2
"""Median difference of ranges from which two scans are of two views."""
LIKE_SHARE = 0.25
"""Largest difference from a scan of the same view, as a share of that from the other view."""
MANY_ALTERNATING, FEWEST_ALTERNATING = 0.5, 20
"""Share of scans that alternate, and number of scans, from which there is a warning."""


@dataclass(slots=True)
class Alternation:
    """Counts the scans of a sensor that differ from the last scan and resemble the last but one."""

    count: int = 0
    _last_two: list[NDArray[np.float32]] = field(default_factory=list)

    def add(self, scan: Scan) -> None:
        """Add the sensor's next scan."""
        ranges = _within_limits(scan)
        if len(self._last_two) == 2:
            own, other = self._last_two
            other_m = difference_m(ranges, other)
            self.count += other_m > UNLIKE_M and difference_m(ranges, own) < LIKE_SHARE * other_m
        self._last_two = [*self._last_two[-1:], ranges]

    def is_found(self, scans: int) -> bool:
        """Whether most of the `scans` alternate."""
        return scans >= FEWEST_ALTERNATING and self.count > MANY_ALTERNATING * scans


class TwoLasers:
    """Tells the scans of two lasers apart: each belongs to the one with the more similar last scan."""

    def __init__(self) -> None:
        self._last: dict[int, NDArray[np.float32]] = {}

    def number_of(self, scan: Scan) -> int:
        """The laser of the next scan, 1 or 2; the first scan is of laser 1."""
        ranges = _within_limits(scan)
        off_m = {number: difference_m(ranges, last) for number, last in self._last.items()}
        number = min(off_m, key=off_m.__getitem__, default=1)
        if len(off_m) == 1 and off_m[1] > UNLIKE_M:
            number = 2
        self._last[number] = ranges
        return number


def difference_m(one: NDArray[np.float32], other: NDArray[np.float32]) -> float:
    """The median difference of ranges (B,) that both scans have, metres; infinite for other numbers of beams."""
    if one.size != other.size:
        return math.inf
    with np.errstate(invalid="ignore"):
        differences = np.abs(one - other)
    known = differences[np.isfinite(differences)]
    return float(np.median(known)) if known.size else 0.0


def _within_limits(scan: Scan) -> NDArray[np.float32]:
    """The ranges (B,), no return as the maximum range."""
    return np.minimum(scan.ranges, np.float32(scan.range_max))
