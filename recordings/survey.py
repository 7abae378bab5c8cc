"""Statistics of a recording from one pass over its scans, and the file that stores them."""

from __future__ import annotations

import gzip
import json
import math
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.files import atomic_write
from gridtrack.common.geometry import SE2, same_pose
from gridtrack.common.notices import Notice
from gridtrack.common.scan import Scan
from gridtrack.recordings.alternation import Alternation
from gridtrack.recordings.meaning import END_M, at_end
from gridtrack.recordings.pose_checks import PoseDrift, PoseJumps
from gridtrack.recordings.resample import JITTER_PERIODS

if TYPE_CHECKING:
    from gridtrack.recordings.recording import Recording

MANY_INVALID, MANY_CODES = 0.2, 0.05
"""Share of invalid ranges for a warning, and share of ranges that may be a code for no return."""
ENOUGH_PERIODS, BURST_PERIODS, MANY_PAUSES = 20, 2.0, 0.1
"""Stamps come in bursts if the mean period, and this share of at least this many periods, is this many medians."""
ENOUGH_ALIKE = 100
"""Returns at one distance, and none elsewhere, from which on this distance is a constant of the driver."""
MIN_REST_S = 10.0
"""Shorter rests of a sensor are not suggested as a stretch."""


@dataclass
class SensorSurvey:
    """Stamps and counts of the scans of one sensor."""

    first: Scan
    stamps: array[int] = field(default_factory=lambda: array("q"))
    beams: set[int] = field(default_factory=set)
    moved: bool = False
    rest_pose: SE2 = field(default_factory=SE2)
    rest_ns: tuple[int, int] = (0, 0)
    """Stamps of the first and last scan of the current rest."""
    longest_rest_ns: tuple[int, int] = (0, 0)
    no_return: int = 0
    at_end: int = 0
    """Ranges at the end of the range, which may be a code for no return."""
    invalid: int = 0
    zeros: int = 0
    readings: int = 0
    nearest: float = math.inf
    farthest: float = -math.inf
    """The smallest and the largest finite range other than 0.0, metres, whether valid or not."""
    labelled: int = 0
    with_truth: int = 0
    with_people: int = 0
    people_ns: tuple[int, int] = (0, 0)
    """Stamps of the first and last scan with annotated people."""
    jumps: PoseJumps = field(default_factory=PoseJumps)
    drift: PoseDrift = field(default_factory=PoseDrift)
    rest: PoseDrift = field(default_factory=lambda: PoseDrift(at_rest=True))
    alternation: Alternation = field(default_factory=Alternation)

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
        self.at_end += int(np.count_nonzero(at_end(scan) & (scan.ranges <= np.float32(scan.range_max))))
        self.invalid += int(np.count_nonzero(~(scan.ranges >= np.float32(scan.range_min))))
        self.zeros += int(np.count_nonzero(scan.ranges == 0.0))
        finite = scan.ranges[np.isfinite(scan.ranges) & (scan.ranges != 0.0)]
        self.nearest = min(self.nearest, float(finite.min(initial=math.inf)))
        self.farthest = max(self.farthest, float(finite.max(initial=-math.inf)))
        self.labelled += scan.labels is not None
        self.with_truth += scan.scene is not None
        if scan.people is not None:
            self.people_ns = (self.people_ns[0] if self.with_people else scan.stamp_ns, scan.stamp_ns)
            self.with_people += 1
        self.jumps.add(scan.stamp_ns, scan.world_T_sensor)
        self.drift.add(scan)
        self.alternation.add(scan)
        if not self.moved:
            self.rest.add(scan)

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """Stamps of the scans, (n,) int64."""
        return np.frombuffer(self.stamps, np.int64)

    @property
    def period_s(self) -> float | None:
        """Median time between scans; None for fewer than two."""
        return float(np.median(np.diff(self.stamps_ns))) / 1e9 if len(self.stamps) > 1 else None

    @property
    def bursts(self) -> str:
        """A line about stamps that come in bursts, without a remedy; else empty.

        A buffer gives several scans the time at which it was read. A few gaps are no bursts.
        """
        periods_s = np.diff(self.stamps_ns) / 1e9
        if periods_s.size < ENOUGH_PERIODS:
            return ""
        median_s, mean_s = float(np.median(periods_s)), float(np.mean(periods_s))
        if mean_s < BURST_PERIODS * median_s or np.mean(periods_s > BURST_PERIODS * median_s) < MANY_PAUSES:
            return ""
        return (
            f"its stamps come in bursts: {1 / mean_s:.3g} scans a second, but half of them less than"
            f" {median_s * 1e3:.3g} ms after another: frames at that distance are empty: give --rate {1 / mean_s:.3g}"
        )

    def notices(self, first_ns: int) -> Iterator[Notice]:
        """The notices about ranges and poses; `first_ns` is the stamp of the recording's first scan."""
        for one in (*self._about_ranges(), *self._about_jumps(first_ns)):
            yield one.model_copy(update={"text": f"sensor '{self.first.sensor}': {one.text}"})

    def _about_jumps(self, first_ns: int) -> Iterator[Notice]:
        if text := self.jumps.warning(first_ns):
            yield Notice(text=text, kind="the poses jump: walls are in two places there")

    def _about_ranges(self) -> Iterator[Notice]:
        """Notices of ranges that measure nothing, or else of many that are invalid, exactly 0.0, or at the end of the
        range."""
        if nothing := self.nothing_measured():
            yield Notice(text=nothing)
            return
        at_end, invalid, zeros = (count / max(self.readings, 1) for count in (self.at_end, self.invalid, self.zeros))
        if at_end > MANY_CODES:
            yield Notice(
                text=f"{at_end:.1%} of the ranges are {self.first.range_max:g} m, its maximum, or up to"
                f" {END_M * 100:g} cm less: walls at that distance. Where the driver writes this for no return, import"
                " the recording with --no-return max",
                kind="{} % of the ranges are the maximum of the laser or little less: walls at that distance",
                values=(round(100 * at_end),),
            )
        if invalid > MANY_INVALID:
            codes = "zero" if zeros > MANY_CODES else "nan"
            yield Notice(
                text=f"{invalid:.1%} of the ranges are invalid (NaN or below range_min)"
                + (f" and {zeros:.1%} exactly 0.0" if zeros > MANY_CODES else "")
                + f": nothing is known on these beams. Where the driver writes {'0.0' if codes == 'zero' else 'NaN'}"
                f" for no return, import the recording with --no-return {codes}",
                kind="{} % of the ranges are invalid (NaN or below range_min): nothing is known on these beams",
                values=(round(100 * invalid),),
            )

    def nothing_measured(self) -> str:
        """Why the ranges measure nothing, with the likely cause; empty if they do."""
        hits = self.readings - self.no_return - self.invalid
        low_m, high_m = self.first.range_min, self.first.range_max
        if hits > ENOUGH_ALIKE and self.nearest == self.farthest:
            return (
                f"every return is at {self.nearest:g} m: the driver writes a constant, or the laser is covered or"
                " switched off"
            )
        if hits:
            return ""
        nothing = (
            f"nothing is occupied, because no range lies between range_min and range_max ({low_m:g} to {high_m:g})"
        )
        if math.isfinite(self.nearest):
            remedy = _likely_unit(self.nearest, self.farthest, low_m, high_m)
            return f"{nothing}: they are {self.nearest:g} to {self.farthest:g}; {remedy}"
        counts = {"0.0": self.zeros, "NaN": self.invalid - self.zeros, "inf": self.no_return}
        values = " or ".join(value for value, count in counts.items() if count)
        return f"{nothing}: all are {values}; the laser was covered or switched off, or its driver failed"

    def missing(self, stamps_ns: NDArray[np.int64], period_ns: float) -> NDArray[np.bool_]:
        """Marks (n,) of the ticks `stamps_ns` without a scan of this sensor, if there are others (`resample_scans`)."""
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
    """All sensors of a recording, in the order of their first scans, and the topics of its file."""

    sensors: dict[str, SensorSurvey] = field(default_factory=dict)
    topics: dict[str, tuple[str, int]] = field(default_factory=dict)

    def add(self, scan: Scan) -> None:
        """Add the next scan."""
        if scan.sensor not in self.sensors:
            self.sensors[scan.sensor] = SensorSurvey(scan)
        self.sensors[scan.sensor].add(scan)

    def notices(self) -> Iterator[Notice]:
        """The notices about the ranges and the poses of the sensors."""
        for sensor in self.sensors.values():
            yield from sensor.notices(self.first_ns)

    @property
    def nothing_measured(self) -> str:
        """Why no sensor measures anything, by the first of them; empty if one does."""
        found = [sensor.nothing_measured() for sensor in self.sensors.values()]
        return found[0] if found and all(found) else ""

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
        """The duration, rounded down: to seconds, or to milliseconds if it is below one second."""
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
        """The longest rest of the first sensor, less a margin at both ends, in tenths of seconds.

        None if it is shorter than MIN_REST_S.
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
        """The lowest median rate of a sensor, rounded to 0.1 Hz: then every sensor has a scan for every tick."""
        periods = [p for s in self.sensors.values() if (p := s.period_s) is not None]
        if not periods:
            return None
        rate = 1.0 / max(periods)
        return round(rate, 1) if rate >= 1.0 else float(f"{rate:.2g}")


def _likely_unit(nearest: float, farthest: float, low_m: float, high_m: float) -> str:
    """Remedy for ranges outside the limits: by the unit that would make them fit, if there is one."""
    for unit, factor in (("centimetres", 1e2), ("millimetres", 1e3)):
        if low_m <= farthest / factor <= high_m:
            return f"the ranges are probably {unit}: convert them, and let the driver write metres (ROS REP 117)"
        if low_m <= nearest * factor and farthest * factor <= high_m:
            limits = f"{low_m / factor:g},{high_m / factor:g}"
            return f"the limits are probably {unit}: import the recording with --range-limits {limits}"
    return "give the limits of the laser with --range-limits"


def write_survey(recording: Recording, path: Path) -> None:
    """Write the survey of `recording`, its warnings and damage to `path`. Raises RecordingError, OSError."""
    survey = recording.survey
    about = {
        "sensors": {name: _plain(sensor) for name, sensor in survey.sensors.items()},
        "topics": survey.topics,
        "warnings": recording.warning_texts(),
        "damage": recording.damage,
    }
    with atomic_write(path) as file:
        file.write(gzip.compress(json.dumps(about).encode(), mtime=0))


def recall_survey(recording: Recording, path: Path) -> None:
    """Let `recording` use the survey that `write_survey` wrote about the same file. Raises OSError."""
    about = json.loads(gzip.decompress(path.read_bytes()))
    like = SensorSurvey(Scan(0, np.empty(0, np.float32), 0.0, 0.0, 0.0, 0.0, reference_T_sensor=SE2()))
    sensors = {name: _restored(like, values) for name, values in about["sensors"].items()}
    topics = {topic: (kind, count) for topic, (kind, count) in about["topics"].items()}
    recording.recall(Survey(sensors, topics), about["warnings"], about["damage"])


def _plain(value: Any) -> Any:
    """A value as JSON has it: the public fields of a dataclass, but labels and truth of the first scan."""
    if isinstance(value, Scan):
        value = replace(value, labels=None, scene=None, people=None, pose_quality=None, last_angle=None)
    if is_dataclass(value):
        public = (field.name for field in fields(value) if not field.name.startswith("_"))
        return {name: _plain(getattr(value, name)) for name in public}
    if isinstance(value, dict):
        return {key: _plain(one) for key, one in value.items()}
    return list(value) if isinstance(value, set) else value.tolist() if hasattr(value, "tolist") else value


def _restored(like: Any, value: Any) -> Any:
    """The value of `_plain`, of the types in `like`."""
    kind: Any = type(like)
    if is_dataclass(like) and value is not None:
        return kind(**{name: _restored(getattr(like, name), one) for name, one in value.items()})
    if isinstance(like, dict):
        return {key: _restored(one, value[str(key)]) for key, one in like.items()}
    if isinstance(like, array):
        return array(like.typecode, value)
    if isinstance(like, np.ndarray):
        return np.array(value, like.dtype)
    return kind(value) if isinstance(like, set | tuple) else value
