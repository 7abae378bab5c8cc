"""Options of reading a recording: the topic, strictness, point clouds, poses and mounts."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from gridtrack.common.config import Settings, parse_pairs, validated
from gridtrack.common.options import Option, from_text
from gridtrack.common.scan import MAX_RANGE_M
from gridtrack.recordings.mounts import Mount, parse_mount

NO_POSES = "none"
"""The pose topic of a recording whose sensors stand still."""


class CloudSlice(Settings):
    """How a point cloud becomes a scan: the nearest point of each bearing between two heights, metres, sensor frame.

    `empty` is the meaning of a bearing without a point in the slice: "free" up to `range_max_m`, like a laser's beam
    without a return, or "unknown", like no beam. Free is right for a dense cloud from a sensor that looks over all
    obstacles below the slice. With few rings, or a slice above low obstacles, it marks unobserved cells as free: use a
    shorter `range_max_m`, or "unknown".
    """

    low_m: float
    high_m: float
    beams: int = Field(default=720, ge=1, le=36_000)
    range_min_m: float = Field(default=0.1, ge=0.0)
    range_max_m: float = Field(default=50.0, gt=0.0, le=MAX_RANGE_M)
    empty: Literal["free", "unknown"] = "free"

    @model_validator(mode="after")
    def _check_limits(self) -> CloudSlice:
        if self.low_m >= self.high_m or self.range_min_m >= self.range_max_m:
            raise ValueError("the lower limit must be below the upper one")
        return self


def parse_cloud_slice(text: str) -> CloudSlice:
    """Read `low_m=0.2,high_m=1.0,...`. Raises ConfigurationError."""
    return validated(CloudSlice, parse_pairs(text, "--cloud-slice"), "--cloud-slice")


class ReadOptions(Settings):
    """How a recording is read. Opening a file refuses options that its format cannot use."""

    topic: Annotated[str | None, Option(metavar="TOPIC")] = None
    """Read the scans of this topic only, if the recording has several"""
    strict: bool = False
    """Refuse a recording with a fault, instead of giving a warning"""
    cloud_slice: Annotated[CloudSlice | None, Option(metavar="KEY=VALUE,..."), from_text(parse_cloud_slice)] = None
    """How a point cloud becomes a scan: low_m=0.2,high_m=1.0; bearings without points are free up to range_max_m, or
    unknown with empty=unknown"""
    pose_topic: Annotated[str | None, Option(metavar="TOPIC")] = None
    """Topic with the poses of the robot, where the transforms are not right; none: it stands still"""
    mounts: Annotated[tuple[Annotated[Mount, from_text(parse_mount)], ...], Option("mount", "SENSOR=X,Y,ANGLE")] = ()
    """Place of a sensor on the robot: laser=0.4,0.2,45deg, with ,mirrored if it is upside down; repeat for several"""
    zero_range: Literal["free", "unknown"] | None = None
    """Meaning of a range of exactly 0.0: free up to the maximum range (no return), or unknown (invalid); default: as
    any range, invalid below the minimum range"""
