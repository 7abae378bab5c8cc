"""The overview of a recording, for `gridtrack recording info`."""

from __future__ import annotations

import math

import numpy as np

from gridtrack.common.config import Settings
from gridtrack.common.errors import bounded_line
from gridtrack.recordings.survey import SensorSurvey

MOTION = {True: "moves", False: "stands still", None: "its poses are not known"}
"""Texts for `SensorOverview.moves`."""


class SensorOverview(Settings):
    """One sensor of a recording; `jitter_ms` is the 95th percentile of |period - median period|."""

    scans: int
    rate_hz: float | None
    jitter_ms: float | None
    gaps: int
    longest_gap_s: float
    beams: tuple[int, int]
    field_of_view_deg: float
    angle_min_deg: float
    range_min: float
    range_max: float
    no_return_share: float
    invalid_share: float
    zero_share: float = 0.0
    """Share of ranges that are exactly 0.0."""
    labelled_scans: int
    scans_with_truth: int
    scans_with_people: int = 0
    """Scans in the stretches with annotated people."""
    moves: bool | None
    """None if its poses are not known."""
    pose_drift_m: float | None = None
    """Distance by which its poses displace a wall in a second (`PoseDrift`); None if it hardly moves or sees too
    little."""

    @classmethod
    def of(cls, sensor: SensorSurvey, *, poses_known: bool) -> SensorOverview:
        """The overview of a sensor."""
        first, period_s, drift_m = sensor.first, sensor.period_s, sensor.drift.median_m
        periods = np.diff(sensor.stamps_ns) / 1e9
        gaps = sensor.gaps(round(period_s * 1e9)) if period_s else np.empty((0, 2), np.int64)
        span = (gaps[:, 1] - gaps[:, 0]) / 1e9
        readings = max(sensor.readings, 1)
        return cls(
            scans=len(sensor.stamps),
            rate_hz=round(1.0 / period_s, 3) if period_s else None,
            jitter_ms=round(float(np.percentile(abs(periods - period_s), 95)) * 1e3, 3) if period_s else None,
            gaps=len(gaps),
            longest_gap_s=round(float(span.max(initial=0.0)), 3),
            beams=(min(sensor.beams), max(sensor.beams)),
            field_of_view_deg=round(math.degrees(abs(first.angle_increment)) * max(first.ranges.size - 1, 0), 2),
            angle_min_deg=round(math.degrees(first.angle_min), 2),
            range_min=round(first.range_min, 4),
            range_max=round(first.range_max, 4),
            no_return_share=round(sensor.no_return / readings, 4),
            invalid_share=round(sensor.invalid / readings, 4),
            zero_share=round(sensor.zeros / readings, 4),
            labelled_scans=sensor.labelled,
            scans_with_truth=sensor.with_truth,
            scans_with_people=sensor.with_people,
            moves=sensor.moved if poses_known else None,
            pose_drift_m=round(drift_m, 4) if poses_known and drift_m is not None else None,
        )


class RecordingOverview(Settings):
    """The content of a recording: `str()` for people, `model_dump_json()` for programs."""

    path: str
    sha256: str
    info: dict[str, object]
    topics: dict[str, str]
    duration_s: float
    sensors: dict[str, SensorOverview]
    warnings: tuple[str, ...]

    def __str__(self) -> str:
        lines = [f"{self.path}: {self.duration_s:.1f} s, sha256 {self.sha256[:16]}..."]
        lines += [f"  {key}: {_as_text(value)}" for key, value in self.info.items() if value]
        lines += [f"  topic {topic}: {content}" for topic, content in self.topics.items()]
        for name, sensor in self.sensors.items():
            lines += [f"  sensor {name}: {line}" for line in _sensor_lines(sensor)]
        return "\n".join(map(bounded_line, lines + [f"  warning: {w}" for w in self.warnings]))


def _as_text(value: object) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{k} {_as_text(v)}" for k, v in value.items())
    if isinstance(value, list | tuple) and all(isinstance(v, str) for v in value):
        return ", ".join(map(str, value))
    if isinstance(value, list | tuple):
        return " to ".join("the end" if v is None else str(v) for v in value)
    return str(value)


def _sensor_lines(s: SensorOverview) -> list[str]:
    beams = f"{s.beams[0]}" if s.beams[0] == s.beams[1] else f"{s.beams[0]} to {s.beams[1]}"
    rate = "one scan" if s.rate_hz is None else f"{s.rate_hz:g} Hz, jitter {s.jitter_ms:g} ms"
    return [
        f"{s.scans} scans, {rate}, " + (f"gaps: {s.gaps}, the longest {s.longest_gap_s:g} s" if s.gaps else "no gaps"),
        f"{beams} beams over {s.field_of_view_deg:g} deg from {s.angle_min_deg:g} deg,"
        f" {s.range_min:g} to {s.range_max:g} m, {MOTION[s.moves]}"
        + ("" if s.pose_drift_m is None else f"; by its poses a wall moves {s.pose_drift_m:.3f} m in a second"),
        f"{s.no_return_share:.1%} no return, {s.invalid_share:.1%} invalid, {s.zero_share:.1%} exactly 0.0,"
        f" {s.labelled_scans} scans labelled"
        + (f", {s.scans_with_truth} scans with truth" if s.scans_with_truth else "")
        + (f", {s.scans_with_people} scans with annotated people" if s.scans_with_people else ""),
    ]
