"""The metadata of a recording: its site, classes, grid, rate, stretches and origin."""

from __future__ import annotations

from typing import Any

from pydantic import Field, SerializerFunctionWrapHandler, field_validator, model_serializer

from gridtrack.common.config import Settings
from gridtrack.common.files import LABEL_RULE, NAME_RULE, is_label, is_name
from gridtrack.common.grid import GridSpec
from gridtrack.common.scan import MAX_RATE_HZ, MIN_RATE_HZ

Stretch = tuple[float, float | None]
"""(start, end) in seconds from the recording's first scan; the end is excluded, None is the end of the recording."""


NO_MOTION = "no motion recorded: assumed at rest (if the robot drives: --ego-motion kiss-icp)"
"""The end of `RecordingInfo.poses` if the sensors are at rest by assumption."""
MATCHED_POSES = ("kiss-icp", "refined")
"""Beginnings of `RecordingInfo.poses` for poses from matching the scans: they agree with the scans."""


def stretch_text(stretch: Stretch) -> str:
    """A stretch as on the command line: `75s-90s`, or `90s-` to the end."""
    start_s, end_s = stretch
    return f"{start_s:g}s-" if end_s is None else f"{start_s:g}s-{end_s:g}s"


class RecordingInfo(Settings):
    """Metadata of a recording: `site`, `classes` of its labels, recommended `grid` and `rate_hz`, named `stretches`,
    the period `cycle_s` of events that repeat at the site, such as a cycle of traffic lights, and its origin.
    """

    site: str
    classes: tuple[str, ...] = Field(default=(), max_length=255)
    grid: str | None = None
    rate_hz: float | None = Field(default=None, ge=MIN_RATE_HZ, le=MAX_RATE_HZ)
    cycle_s: float | None = Field(default=None, gt=0.0, le=86_400.0)
    stretches: dict[str, Stretch] = Field(default_factory=dict)
    licence: str = ""
    credit: str = ""
    poses: str = ""
    """The source of the sensors' poses; not written if it is empty."""
    source: str = ""
    source_sha256: str = ""
    command: str = ""

    @model_serializer(mode="wrap")
    def _without_empty_poses(self, values_of: SerializerFunctionWrapHandler) -> dict[str, Any]:
        values: dict[str, Any] = values_of(self)
        if not self.poses:
            del values["poses"]
        return values

    @property
    def assumes_rest(self) -> bool:
        """Whether no motion is recorded, and the user has not said that the sensors are at rest."""
        return self.poses.endswith(NO_MOTION)

    @property
    def has_matched_poses(self) -> bool:
        """Whether the poses are from matching the scans."""
        return self.poses.startswith(MATCHED_POSES)

    @field_validator("grid")
    @classmethod
    def _check_grid(cls, grid: str | None) -> str | None:
        return None if grid is None else str(GridSpec.parse(grid))

    @field_validator("site")
    @classmethod
    def _check_site(cls, site: str) -> str:
        if not is_name(site):
            raise ValueError(NAME_RULE)
        return site

    @field_validator("classes")
    @classmethod
    def _check_classes(cls, classes: tuple[str, ...]) -> tuple[str, ...]:
        for name in classes:
            if not is_label(name):
                raise ValueError(f"class {name[:40]!r}: {LABEL_RULE}")
        return classes

    @field_validator("stretches")
    @classmethod
    def _check_stretches(cls, stretches: dict[str, Stretch]) -> dict[str, Stretch]:
        for name, (start_s, end_s) in stretches.items():
            if not is_name(name):
                raise ValueError(f"stretch {name[:40]!r}: {NAME_RULE}")
            if start_s < 0.0 or (end_s is not None and end_s <= start_s):
                raise ValueError(
                    f"stretch '{name}' is from {start_s} s to {end_s} s: expected 0 or more, and an end after the start"
                )
        return stretches
