"""Statistics of a recording from one pass over its scans, kept in a file."""

from __future__ import annotations

import json
import math
from array import array
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.config import Settings
from gridtrack.common.errors import bounded_line
from gridtrack.common.geometry import SE2, same_pose
from gridtrack.common.scan import Scan
from gridtrack.recordings.pose_checks import PoseDrift, PoseJumps
from gridtrack.recordings.recording import Recording
from gridtrack.recordings.resample import JITTER_PERIODS

MANY_INVALID, MANY_ZEROS = 0.2, 0.05
"""Share of a sensor's ranges above which there is a warning, and above which it names those that are 0.0."""

MIN_REST_S = 10.0
"""A shorter rest of a sensor is not worth to be suggested as a stretch."""


@dataclass
class SensorSurvey:
    """Stamps and counts of the scans of one sensor."""

    first: Scan
    stamps: array[int] = field(default_factory=lambda: array("q"))
    beams: set[int] = field(default_factory=set)
    moved: bool = False
    rest_pose: SE2 = field(default_factory=SE2)
    rest_ns: tuple[int, int] = (0, 0)
    """The rest that the newest scan belongs to: stamps of its first and last scan."""
    longest_rest_ns: tuple[int, int] = (0, 0)
    no_return: int = 0
    invalid: int = 0
    zeros: int = 0
    readings: int = 0
    labelled: int = 0
    with_truth: int = 0
    jumps: PoseJumps = field(default_factory=PoseJumps)
    drift: PoseDrift = field(default_factory=PoseDrift)

    def add(self, scan: Scan) -> None:
        """Add the sensor's next scan."""
        if not self.stamps or not same_pose(scan.world_T_sensor, self.rest_pose):
            self.rest_pose, self.rest_ns = scan.world_T_sensor, (scan.stamp_ns, scan.stamp_ns)
        self.rest_ns = (self.rest_ns[0], scan.stamp_ns)
        self.longest_rest_ns = max(self.longest_rest_ns, self.rest_ns, key=lambda rest: rest[1] - rest[0])
        self.stamps.append(scan.stamp_ns)
        self.beams.add(scan.ranges.size)
        self.moved = self.moved or scan.world_T_sensor != self.first.world_T_sensor
        self.readings += scan.ranges.size
        self.no_return += int(np.count_nonzero(scan.ranges > np.float32(scan.range_max)))
        self.invalid += int(np.count_nonzero(~(scan.ranges >= np.float32(scan.range_min))))
        self.zeros += int(np.count_nonzero(scan.ranges == 0.0))
        self.labelled += scan.labels is not None
        self.with_truth += scan.scene is not None
        self.jumps.add(scan.stamp_ns, scan.world_T_sensor)
        self.drift.add(scan)

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """Stamps of the scans, (n,) int64."""
        return np.frombuffer(self.stamps, np.int64)

    @property
    def period_s(self) -> float | None:
        """Median time between scans; None for fewer than two."""
        return float(np.median(np.diff(self.stamps_ns))) / 1e9 if len(self.stamps) > 1 else None

    def warnings(self, first_ns: int) -> Iterator[str]:
        """The warnings about ranges and poses; `first_ns` is the stamp of the recording's first scan."""
        for text in (self._about_ranges(), self.jumps.warning(first_ns)):
            if text:
                yield f"sensor '{self.first.sensor}': {text}"

    def _about_ranges(self) -> str:
        """Many ranges that are invalid or exactly 0.0."""
        invalid, zeros = self.invalid / max(self.readings, 1), self.zeros / max(self.readings, 1)
        if max(invalid, zeros) <= MANY_INVALID:
            return ""
        text = f"{invalid:.1%} of the ranges are invalid (NaN or below range_min)"
        if zeros > MANY_ZEROS:
            text += (
                f" and {zeros:.1%} exactly 0.0: where the driver writes 0.0 for no return, import the recording with"
                " --zero-range free, else with --zero-range unknown"
            )
        return text

    def missing(self, stamps_ns: NDArray[np.int64], period_ns: float) -> NDArray[np.bool_]:
        """Which of `stamps_ns` (n,), a period apart, have no scan of this sensor beside others (`resample_scans`)."""
        own = self.stamps_ns
        after = np.searchsorted(own, stamps_ns).clip(0, len(own) - 1)
        before = (after - 1).clip(0)
        nearest = np.minimum(np.abs(own[after] - stamps_ns), np.abs(own[before] - stamps_ns))
        around = (own[before] < stamps_ns) & (stamps_ns <= own[after])
        in_a_gap = ~around | (own[after] - own[before] > JITTER_PERIODS * period_ns)
        missing: NDArray[np.bool_] = (2 * nearest > period_ns) & in_a_gap
        return missing

    def gaps(self, period_ns: int) -> NDArray[np.int64]:
        """Gaps between scans longer than two periods: (n, 2) int64, start and end in ns."""
        stamps = self.stamps_ns
        (before,) = np.nonzero(np.diff(stamps) > 2 * period_ns)
        return np.stack([stamps[before], stamps[before + 1]], axis=1)


@dataclass
class Survey:
    """All sensors of a recording, in the order in which they first appear, and the topics of its file."""

    sensors: dict[str, SensorSurvey] = field(default_factory=dict)
    topics: dict[str, tuple[str, int]] = field(default_factory=dict)

    def add(self, scan: Scan) -> None:
        """Add the next scan."""
        if scan.sensor not in self.sensors:
            self.sensors[scan.sensor] = SensorSurvey(scan)
        self.sensors[scan.sensor].add(scan)

    def warnings(self) -> list[str]:
        """The warnings about the ranges and the poses of the sensors."""
        return [text for sensor in self.sensors.values() for text in sensor.warnings(self.first_ns)]

    def pose_drift(self, remedy: str) -> str:
        """The warning about the first sensor whose poses disagree with its scans, with the `remedy`; else empty."""
        found = ((name, sensor.drift.problem(remedy)) for name, sensor in self.sensors.items())
        return next((f"sensor '{name}': {problem}" for name, problem in found if problem), "")

    @property
    def first_ns(self) -> int:
        """Stamp of the first scan."""
        return min(s.stamps[0] for s in self.sensors.values())

    @property
    def last_ns(self) -> int:
        """Stamp of the last scan."""
        return max(s.stamps[-1] for s in self.sensors.values())

    @property
    def duration_s(self) -> float:
        """From the first scan to the last."""
        return (self.last_ns - self.first_ns) / 1e9

    @property
    def whole_s(self) -> float:
        """The duration in whole seconds where it is longer than one, else in milliseconds, rounded down."""
        return math.floor(self.duration_s) if self.duration_s >= 1.0 else math.floor(self.duration_s * 1e3) / 1e3

    def gaps(self, longer_than_ns: int) -> NDArray[np.int64]:
        """Gaps in which no sensor has a scan: (n, 2) int64, start and end in ns."""
        stamps = np.sort(np.concatenate([sensor.stamps_ns for sensor in self.sensors.values()]))
        (before,) = np.nonzero(np.diff(stamps) > longer_than_ns)
        return np.stack([stamps[before], stamps[before + 1]], axis=1)

    @property
    def moves(self) -> bool:
        """Whether any sensor changes its pose."""
        return any(s.moved for s in self.sensors.values())

    def longest_rest_s(self, margin_s: float) -> tuple[float, float] | None:
        """The longest stretch in which the first sensor is at rest, less a margin at both ends, in tenths of seconds.

        None where it is shorter than MIN_REST_S.
        """
        first_ns, sensor = self.first_ns, next(iter(self.sensors.values()))
        start_s, end_s = ((stamp_ns - first_ns) / 1e9 for stamp_ns in sensor.longest_rest_ns)
        start_s, end_s = math.ceil((start_s + margin_s) * 10) / 10, math.floor((end_s - margin_s) * 10) / 10
        return (start_s, end_s) if end_s - start_s >= MIN_REST_S else None

    @property
    def poses(self) -> dict[str, SE2]:
        """The pose of each sensor at its first scan, `world_T_sensor`."""
        return {name: s.first.world_T_sensor for name, s in self.sensors.items()}

    @property
    def rate_hz(self) -> float | None:
        """The lowest median rate of a sensor, rounded to 0.1 Hz: at it every sensor has a scan for every tick."""
        periods = [p for s in self.sensors.values() if (p := s.period_s) is not None]
        if not periods:
            return None
        rate = 1.0 / max(periods)
        return round(rate, 1) if rate >= 1.0 else float(f"{rate:.2g}")

    def sensor_overviews(self, *, poses_known: bool) -> dict[str, SensorOverview]:
        """The overview of each sensor for `recording info`."""
        return {name: _overview(sensor, poses_known) for name, sensor in self.sensors.items()}


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
    moves: bool | None
    """None: its poses are not known, so nobody can tell."""
    pose_drift_m: float | None = None
    """How far its poses displace a wall in a second (`PoseDrift`); None where it hardly moves or sees too little."""


def _overview(sensor: SensorSurvey, poses_known: bool) -> SensorOverview:
    first, period_s, drift_m = sensor.first, sensor.period_s, sensor.drift.median_m
    periods = np.diff(sensor.stamps_ns) / 1e9
    gaps = sensor.gaps(round(period_s * 1e9)) if period_s else np.empty((0, 2), np.int64)
    span = (gaps[:, 1] - gaps[:, 0]) / 1e9
    return SensorOverview(
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
        no_return_share=round(sensor.no_return / max(sensor.readings, 1), 4),
        invalid_share=round(sensor.invalid / max(sensor.readings, 1), 4),
        zero_share=round(sensor.zeros / max(sensor.readings, 1), 4),
        labelled_scans=sensor.labelled,
        scans_with_truth=sensor.with_truth,
        moves=sensor.moved if poses_known else None,
        pose_drift_m=round(drift_m, 4) if poses_known and drift_m is not None else None,
    )


MOTION = {True: "moves", False: "stands still", None: "its poses are not known"}
"""How `SensorOverview.moves` is told."""


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
        lines += [f"  topic {topic}: {what}" for topic, what in self.topics.items()]
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
        + (f", {s.scans_with_truth} scans with truth" if s.scans_with_truth else ""),
    ]


SURVEY_COUNTS = ("moved", "no_return", "invalid", "zeros", "readings", "labelled", "with_truth")
POSE_JUMPS = tuple(field.name for field in fields(PoseJumps) if not field.name.startswith("_"))
FIRST_SCAN = ("stamp_ns", "angle_min", "angle_increment", "range_min", "range_max", "sensor", "time_increment_s")
"""Fields of the first scan that are kept beside its ranges and poses; labels and truth are not."""


def write_survey(recording: Recording, path: Path) -> None:
    """Write the survey of `recording`, its warnings and damage to `path`. Raises RecordingError, OSError."""
    survey = recording.survey
    about = {
        "sensors": {name: _values(sensor) for name, sensor in survey.sensors.items()},
        "topics": survey.topics,
        "warnings": recording.warning_texts(),
        "damage": recording.damage,
    }
    arrays: dict[str, Any] = {}
    for n, sensor in enumerate(survey.sensors.values()):
        arrays |= {f"stamps_{n}": sensor.stamps_ns, f"ranges_{n}": sensor.first.ranges}
    with path.open("wb") as file:
        np.savez_compressed(file, about=np.array(json.dumps(about)), **arrays)


def recall_survey(recording: Recording, path: Path) -> None:
    """Let `recording` take over what `write_survey` wrote about the same file. Raises OSError."""
    with np.load(path, allow_pickle=False) as stored:
        about = json.loads(str(stored["about"]))
        sensors = {
            name: _sensor(values, stored[f"stamps_{n}"], stored[f"ranges_{n}"])
            for n, (name, values) in enumerate(about["sensors"].items())
        }
    topics = {topic: (kind, count) for topic, (kind, count) in about["topics"].items()}
    recording.recall(Survey(sensors, topics), about["warnings"], about["damage"])


def _values(sensor: SensorSurvey) -> dict[str, Any]:
    first = sensor.first
    return {
        "first": {name: getattr(first, name) for name in FIRST_SCAN},
        "pose": asdict(first.world_T_sensor),
        "reference": first.reference_T_sensor and asdict(first.reference_T_sensor),
        "beams": sorted(sensor.beams),
        "longest_rest_ns": sensor.longest_rest_ns,
        "counts": {name: getattr(sensor, name) for name in SURVEY_COUNTS},
        "jumps": {name: getattr(sensor.jumps, name) for name in POSE_JUMPS},
        "drift": sensor.drift.displacements_m.tolist(),
    }


def _sensor(values: Mapping[str, Any], stamps_ns: NDArray[np.int64], ranges: NDArray[np.float32]) -> SensorSurvey:
    reference = values["reference"]
    first = Scan(
        **values["first"],
        ranges=ranges,
        world_T_sensor=SE2(**values["pose"]),
        reference_T_sensor=SE2(**reference) if reference else None,
    )
    return SensorSurvey(
        first,
        stamps=array("q", stamps_ns.tolist()),
        beams=set(values["beams"]),
        longest_rest_ns=tuple(values["longest_rest_ns"]),
        jumps=PoseJumps(**values["jumps"]),
        drift=PoseDrift(array("d", values["drift"])),
        **values["counts"],
    )
