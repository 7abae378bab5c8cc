"""Whether matches drift away from odometry: a crowd that walks one way drags them, scan after scan.

A wheel that slips puts odometry wrong in one scan; what drags a match does so in every scan of a second.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from gridtrack.common.geometry import SE2
from gridtrack.recordings.ego_motion.returns import PlaneArray

WINDOW_NS = 1_000_000_000
DRIFT_M = 0.1
"""A drift over the window that is never too large: that of the matches' own noise."""
MIN_SCANS = 4
"""A drift is judged from so many matches in the window on."""


class DriftFromOdometry:
    """The differences of the matches of the last second from where odometry led from the scan before."""

    def __init__(self, max_deviations: float) -> None:
        self._max_deviations = max_deviations
        self._steps: deque[tuple[int, PlaneArray, float]] = deque()

    def grows(self, stamp_ns: int, predicted: SE2, matched: SE2, position_m: float) -> bool:
        """Add a match, whose prior has this standard deviation; whether all of them together are beyond the noise.

        The largest difference is left out of the sum: it may be a slip.
        """
        self._steps.append((stamp_ns, np.array([matched.x - predicted.x, matched.y - predicted.y]), position_m))
        while stamp_ns - self._steps[0][0] > WINDOW_NS:
            self._steps.popleft()
        if len(self._steps) < MIN_SCANS:
            return False
        off = np.array([step for _, step, _ in self._steps])
        slip = int(np.hypot(*off.T).argmax())
        drift = off.sum(axis=0) - off[slip]
        noise_m = math.sqrt(sum(sigma**2 for _, _, sigma in self._steps))
        return float(np.hypot(*drift)) > DRIFT_M + self._max_deviations * noise_m
