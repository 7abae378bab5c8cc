"""What a stream tells about several sensors that share its frames: scans that are missing, and rates that differ."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gridtrack.recordings.recording_info import Stretch, stretch_text
from gridtrack.recordings.survey import Survey

SLOW = 1.5
"""A sensor is slow whose period is so many times that of the fastest one."""


def missing_scans(survey: Survey, stamps_ns: NDArray[np.int64], period_s: float, stretch_s: Stretch) -> Iterator[str]:
    """A line for each sensor without a scan for some of the frames, stamped `stamps_ns` (n,)."""
    for name, sensor in survey.sensors.items():
        missing = sensor.missing(stamps_ns, period_s * 1e9)
        if missing.any():
            first_s = (stamps_ns[missing.argmax()] - survey.first_ns) / 1e9
            yield (
                f"sensor '{name}': no scan within half a period of {period_s:g} s of {missing.sum()} of"
                f" {len(missing)} frames in {stretch_text(stretch_s)}, the first at {first_s:.2f} s; they are"
                " made of the scans of the other sensors"
            )


def slow_sensor(survey: Survey) -> Iterator[str]:
    """A line where one sensor, whose rate is that of the frames, is so slow that scans of the others are not used."""
    periods_s = {name: sensor.period_s for name, sensor in survey.sensors.items() if sensor.period_s}
    if len(periods_s) < 2:
        return
    slow, fast = (end(periods_s, key=periods_s.__getitem__) for end in (max, min))
    if periods_s[slow] > SLOW * periods_s[fast]:
        yield (
            f"frames are made at the rate of the slowest sensor: '{slow}' has {1 / periods_s[slow]:.3g} scans a second,"
            f" '{fast}' {1 / periods_s[fast]:.3g}; --rate {1 / periods_s[fast]:.3g} makes more frames, most of them"
            f" without '{slow}'"
        )
