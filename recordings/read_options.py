"""Options of reading a recording: format, topic, strictness, point clouds, poses, mounts, and meaning of the ranges."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from gridtrack.common.config import Settings, parse_pairs, validated
from gridtrack.common.errors import ConfigurationError
from gridtrack.common.geometry import SE2, wrap_angle
from gridtrack.common.options import Option, from_text
from gridtrack.common.scan import MAX_ANGLE_RAD, MAX_POSITION_M, MAX_RANGE_M, MAX_RATE_HZ, MIN_RATE_HZ

MOUNT_FORM = "SENSOR=X,Y,ANGLE, as in front_laser=0.4,0.2,45deg (metres; deg or rad; ',mirrored' if upside down)"
NoReturn = Literal["max", "zero", "nan"]
PoseSource = Literal["recorded", "kiss-icp", "refined"]
"""Recorded poses; from matching scans alone; from matching scans with the recorded motion as the prior."""
NO_POSES = "none"
"""The pose topic of a recording with sensors at rest."""


class Mount(Settings):
    """The pose of a sensor on the frame `parent`, metres and radians; an empty parent is the robot's body.

    `sensor` is the name of a sensor or of its frame. `mirrored`: mounted upside down, so that its angles run clockwise.
    """

    sensor: str
    parent: str = ""
    x: float = Field(ge=-MAX_POSITION_M, le=MAX_POSITION_M)
    y: float = Field(ge=-MAX_POSITION_M, le=MAX_POSITION_M)
    heading_rad: float
    mirrored: bool = False

    @property
    def parent_T_sensor(self) -> SE2:
        """The pose in the plane."""
        return SE2(self.x, self.y, self.heading_rad)

    def __str__(self) -> str:
        parent = f"{self.parent}:" if self.parent else ""
        degrees = round(math.degrees(self.heading_rad), 9)
        heading = f"{180.0 if degrees == -180.0 else degrees:.9g}deg"
        return f"{self.sensor}={parent}{self.x:.9g},{self.y:.9g},{heading}" + (",mirrored" if self.mirrored else "")


def parse_mount(text: str) -> Mount:
    """Read `front_laser=0.4,0.2,45deg` or `rear=base_link:-0.4,0,3.1rad,mirrored`. Raises ConfigurationError."""
    sensor, _, rest = text.partition("=")
    parent, _, place = rest.rpartition(":")
    numbers = [part.strip() for part in place.split(",")]
    try:
        x, y, heading_rad = float(numbers[0]), float(numbers[1]), wrap_angle(_radians(numbers[2]))
    except (ValueError, IndexError):
        x = y = heading_rad = math.nan
    is_valid = abs(x) <= MAX_POSITION_M and abs(y) <= MAX_POSITION_M and math.isfinite(heading_rad)
    if not sensor.strip() or not is_valid or numbers[3:] not in ([], ["mirrored"]):
        raise ConfigurationError(f"--mount {text}: expected {MOUNT_FORM}")
    return Mount(
        sensor=sensor.strip(), parent=parent.strip(), x=x, y=y, heading_rad=heading_rad, mirrored=len(numbers) == 4
    )


def _radians(text: str) -> float:
    """`45deg` or `0.8rad`; the only number without a unit is 0. Raises ValueError."""
    if text.endswith("deg"):
        return math.radians(float(text.removesuffix("deg")))
    if text.endswith("rad"):
        return float(text.removesuffix("rad"))
    if float(text) != 0.0:
        raise ValueError(text)
    return 0.0


def codes_in(value: Any) -> Any:
    """`max,zero`, or several such texts, as a tuple of codes."""
    texts = [value] if isinstance(value, str) else value
    return tuple(part.strip() for text in texts for part in text.split(","))


def parse_stamps(text: str) -> float | str:
    """Read `header`, `received`, `end` or a rate, `10hz`, in Hz. Raises ConfigurationError."""
    if text in ("header", "received", "end"):
        return text
    try:
        rate_hz = float(text.lower().removesuffix("hz"))
    except ValueError:
        rate_hz = math.nan
    if not MIN_RATE_HZ <= rate_hz <= MAX_RATE_HZ:
        raise ConfigurationError(f"--stamps {text}: expected header, received, end, or a rate such as 10hz")
    return rate_hz


def parse_limits(text: str) -> tuple[float, float]:
    """Read `0.1,30`, metres. Raises ConfigurationError."""
    try:
        low_m, high_m = map(float, text.split(","))
    except ValueError:
        low_m = high_m = math.nan
    if not 0.0 <= low_m < high_m <= MAX_RANGE_M:
        raise ConfigurationError(f"--range-limits {text}: expected MIN,MAX in metres, as in 0.1,30")
    return low_m, high_m


def parse_angles(text: str) -> tuple[float, float]:
    """Read `-135deg,135deg` or `0rad,6.28rad`, in radians. Raises ConfigurationError."""
    try:
        first_rad, last_rad = map(_radians, text.split(","))
    except ValueError:
        first_rad = last_rad = math.nan
    if not 0.0 < abs(last_rad - first_rad) <= MAX_ANGLE_RAD or abs(first_rad) > MAX_ANGLE_RAD:
        raise ConfigurationError(f"--angles {text}: expected FIRST,LAST, as in -135deg,135deg (deg or rad)")
    return first_rad, last_rad


class CloudSlice(Settings):
    """How a point cloud becomes a scan: the nearest point of each bearing between two heights, metres, sensor frame.

    `beams`: bearings of a revolution; by default 720, or as many as the clouds have if they are coarser.
    `empty` is the meaning of a bearing without a point in the slice: "free" up to `range_max_m`, like a beam without a
    return, or "unknown", like no beam. Free is right for a dense cloud from a sensor that sees over all obstacles below
    the slice. With few rings, or a slice above low obstacles, it marks unobserved cells as free: use a shorter
    `range_max_m`, or "unknown".
    """

    low_m: float
    high_m: float
    beams: int | None = Field(default=None, ge=1, le=36_000)
    range_min_m: float = Field(default=0.1, ge=0.0)
    range_max_m: float = Field(default=50.0, gt=0.0, le=MAX_RANGE_M)
    empty: Literal["free", "unknown"] = "free"

    @model_validator(mode="after")
    def _check_limits(self) -> CloudSlice:
        if self.low_m >= self.high_m or self.range_min_m >= self.range_max_m:
            raise ValueError("the lower limit must be below the upper one")
        return self

    def __str__(self) -> str:
        given = self.model_dump(exclude_unset=True)
        return ",".join(f"{key}={value if isinstance(value, str) else f'{value:g}'}" for key, value in given.items())


def parse_cloud_slice(text: str) -> CloudSlice:
    """Read `low_m=0.2,high_m=1.0,...`. Raises ConfigurationError."""
    return validated(CloudSlice, parse_pairs(text, "--cloud-slice"), "--cloud-slice")


class ReadOptions(Settings):
    """How a recording is read: the options of `recording info` and `recording import`, and of `open_recording`.

    Opening a file refuses options that its format cannot use.
    """

    format: Annotated[str | None, Option(metavar="NAME")] = None
    """Recording format of another package, which is loaded only by this name; the formats of gridtrack are found by the
    file itself"""
    topic: Annotated[str | None, Option(metavar="TOPIC", purpose="recordings with several topics")] = None
    """Read the scans of this topic only, if the recording has several"""
    strict: bool = False
    """Refuse a recording with a fault, instead of giving a warning"""
    cloud_slice: Annotated[
        CloudSlice | None,
        Option(metavar="KEY=VALUE,...", texts=lambda cut: [str(cut)], purpose="ROS recordings with point clouds"),
        from_text(parse_cloud_slice),
    ] = None
    """How a point cloud becomes a scan: low_m=0.2,high_m=1.0; bearings without points are free up to range_max_m, or
    unknown with empty=unknown"""
    pose_topic: Annotated[
        str | None, Option(metavar="TOPIC", purpose="recordings with poses on separate topics (ROS, Foxglove)")
    ] = None
    """Topic with the poses of the robot, if the transforms are wrong; none: it stands still"""
    mounts: Annotated[
        tuple[Annotated[Mount, from_text(parse_mount)], ...],
        Option(
            "mount",
            "SENSOR=X,Y,ANGLE",
            texts=lambda mounts: map(str, mounts),
            purpose="recordings with frames in their scans (ROS, Foxglove)",
        ),
    ] = ()
    """Place of a sensor on the robot: laser=0.4,0.2,45deg, with ,mirrored if it is upside down; repeat for several"""
    no_return: Annotated[
        tuple[NoReturn, ...],
        Option(metavar="CODE,...", texts=lambda codes: [",".join(codes)]),
        BeforeValidator(codes_in),
    ] = ()
    """Values that mean no return (free up to the maximum range): max, from 5 cm below the maximum range on; zero; nan.
    By default zero and nan are invalid (unknown), and the maximum range is a return"""
    range_limits: Annotated[
        tuple[float, float] | None,
        Option(metavar="MIN,MAX", texts=lambda limits: [",".join(f"{limit:g}" for limit in limits)]),
        from_text(parse_limits),
    ] = None
    """Range limits of the laser in metres, in place of wrong ones in the recording: 0.1,30"""
    angles: Annotated[
        tuple[float, float] | None,
        Option(metavar="FIRST,LAST", texts=lambda angles: [",".join(f"{angle:.9g}rad" for angle in angles)]),
        from_text(parse_angles),
    ] = None
    """Angles of the first and the last beam, in place of wrong ones in the recording: -135deg,135deg"""

    stamps: Annotated[
        float | Literal["header", "received", "end"],
        Option(
            metavar="SOURCE",
            texts=lambda stamps: [f"{stamps:g}hz" if isinstance(stamps, float) else stamps],
            purpose="ROS recordings and CARMEN logs",
        ),
        from_text(parse_stamps),
    ] = "header"
    """Source of the stamps of scans: header; received, the time of reception; end, the header if it has the time of the
    last beam; or a rate for scans without usable stamps, such as 10hz (CARMEN logs)"""

    @property
    def given(self) -> dict[str, Any]:
        """The options that differ from their defaults, by field."""
        return {name: value for name, value in self if value != type(self).model_fields[name].default}


def reading_options(values: Mapping[str, Any]) -> dict[str, Any]:
    """Those of `values` that are fields of ReadOptions."""
    return {name: value for name, value in values.items() if name in ReadOptions.model_fields}
