"""Options of reading a recording: the topic, strictness, point clouds, poses and mounts."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from gridtrack.common.config import Settings
from gridtrack.common.scan import MAX_RANGE_M
from gridtrack.recordings.mounts import Mount

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


class ReadOptions(Settings):
    """How a recording is read. An option that the format of the file cannot use is refused when the file is opened."""

    topic: str | None = None
    """Read the scans of this topic only."""
    strict: bool = False
    """Raise RecordingError for what otherwise is a warning."""
    cloud_slice: CloudSlice | None = None
    """How a point cloud becomes a scan."""
    pose_topic: str | None = None
    """The topic with the poses of what carries the sensors; "none" where they stand still."""
    mounts: tuple[Mount, ...] = ()
    """The places of sensors on what carries them."""
    zero_range: Literal["free", "unknown"] | None = None
    """The meaning of a range of exactly 0.0, in every format: no return ("free" up to the maximum range) or invalid
    ("unknown"). Without it such a range is as any other: invalid below the minimum range."""
