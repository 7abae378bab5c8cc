"""One revolution of a planar laser."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2
from gridtrack.common.scene import Scene


@dataclass(frozen=True, slots=True)
class Scan:
    """One revolution of one laser.

    `ranges` (B,) float32 in metres, beam i at `angle_min + i * angle_increment` (radians, counter-clockwise, sensor
    frame). A range of +inf or beyond `range_max` is "no return": free up to `range_max`. NaN, -inf and anything below
    `range_min` is invalid and gives no information (ROS REP 117). `labels` (B,) uint8 are indices into the recording's
    classes, UNLABELLED where the class is not known. `scene` is the true scene, where the recording has it. Labels and
    scene are never sent to a tracker.
    """

    stamp_ns: int
    ranges: NDArray[np.float32]
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float
    sensor: str = "scan"
    world_T_sensor: SE2 = field(default_factory=SE2)
    labels: NDArray[np.uint8] | None = None
    scene: Scene | None = None
