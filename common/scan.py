"""One revolution of a planar laser, and the quality of its pose."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2
from gridtrack.common.scene import Person, Scene

MAX_BEAMS = 100_000
MAX_ANGLE_RAD = 4.0 * math.pi
"""Limit of the angle of the first beam, and of the angle from the first beam to the last: two turns."""
MAX_RANGE_M, MAX_POSITION_M = 1e6, 1e9
"""Limits of the maximum range, and of a sensor's coordinates."""
MIN_RATE_HZ, MAX_RATE_HZ = 1e-3, 1e4
MatchOutcome = Literal["start", "matched", "partial", "few-returns", "few-inliers", "far"]
MATCH_OUTCOMES: tuple[str, ...] = get_args(MatchOutcome)


@dataclass(frozen=True, slots=True)
class PoseQuality:
    """The match of a scan with the scans before it.

    `outcome` is `start` for the first scan, `matched`, or `partial` if the surroundings leave a direction of the pose
    open (as along a corridor, or with a single compact cluster, which may move): there the pose is the prior's. It is
    the prior's completely with `few-returns`, `few-inliers`, or a match `far` from the prior. `inlier_share` is the
    share of the returns on the map, `residual_m` their median distance from the map's walls; both are 0 for a scan
    that was not matched.
    """

    outcome: MatchOutcome
    inlier_share: float = 0.0
    residual_m: float = 0.0

    @property
    def failed(self) -> bool:
        """Whether the pose is the prior's."""
        return self.outcome in ("few-returns", "few-inliers", "far")

    @property
    def fell_back(self) -> bool:
        """Whether the pose is the prior's, in full or in part."""
        return self.failed or self.outcome == "partial"


@dataclass(frozen=True, slots=True)
class Scan:
    """One revolution of one laser.

    `ranges` (B,) float32 in metres, beam i at `angle_min + i * angle_increment` (radians, counter-clockwise, sensor
    frame). A range of +inf or beyond `range_max` is "no return": free up to `range_max`. NaN, -inf and anything below
    `range_min` is invalid and gives no information (ROS REP 117). `world_T_sensor` is the pose that trackers get;
    `reference_T_sensor`, if it differs, is the pose for scoring forecasts. `labels` (B,) uint8 are indices into the
    recording's classes, or UNLABELLED. `scene` is the true scene, if the recording has it, in the reference world
    frame. `people` are the annotated persons in the same frame, None where nothing is annotated. Trackers never get
    labels, scene, people and reference poses. Beam i is measured `i * time_increment_s` after the
    stamp; 0 if the beam times are unknown. `last_angle` is the angle of the last beam if the format says it beside the
    other two: they may contradict each other. `pose_quality` is the quality of a pose from matching scans.
    """

    stamp_ns: int
    ranges: NDArray[np.float32]
    angle_min: float
    angle_increment: float
    range_min: float
    range_max: float
    sensor: str = "scan"
    world_T_sensor: SE2 = field(default_factory=SE2)
    reference_T_sensor: SE2 | None = None
    labels: NDArray[np.uint8] | None = None
    scene: Scene | None = None
    time_increment_s: float = 0.0
    last_angle: float | None = None
    pose_quality: PoseQuality | None = None
    people: tuple[Person, ...] | None = None
