"""The meaning of the numbers of a scan: codes for "no return", range limits and angles, as the options of reading say.

Drivers write codes where nothing came back: the maximum range, a value just below it, 0.0 or NaN. Read as ranges they
are a ring of walls, or nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.scan import Scan
from gridtrack.recordings.read_options import NoReturn, ReadOptions

END_M = 0.05
"""The end of the range: distance below the maximum range in which a frequent value is a code."""
LEAST_RANGE_M = 1e-3
"""The least lower limit of ranges: 0.0 is never a return."""


def with_meaning(scan: Scan, options: ReadOptions) -> Scan:
    """The scan with the range limits, angles and codes for no return that the options name."""
    low_m, high_m = options.range_limits or (scan.range_min, scan.range_max)
    low_m = LEAST_RANGE_M if low_m == 0.0 < high_m else low_m
    if (low_m, high_m) != (scan.range_min, scan.range_max):
        scan = replace(scan, range_min=low_m, range_max=high_m)
    if options.angles is not None:
        first_rad, last_rad = options.angles
        step_rad = (last_rad - first_rad) / max(scan.ranges.size - 1, 1)
        scan = replace(scan, angle_min=first_rad, angle_increment=step_rad, last_angle=None)
    if not options.no_return:
        return scan
    is_code = np.zeros(scan.ranges.shape, np.bool_)
    for code in options.no_return:
        is_code |= CODES[code](scan)
    return replace(scan, ranges=np.where(is_code, np.float32(np.inf), scan.ranges)) if is_code.any() else scan


def at_end(scan: Scan) -> NDArray[np.bool_]:
    """Marks (B,) of the ranges from END_M below the maximum range on."""
    return scan.ranges >= np.float32(scan.range_max - END_M)


CODES: dict[NoReturn, Callable[[Scan], NDArray[np.bool_]]] = {
    "max": at_end,
    "zero": lambda scan: scan.ranges == 0.0,
    "nan": lambda scan: np.isnan(scan.ranges),
}
"""The ranges (B,) that are a code for no return."""
