"""The grid stream: a stretch of a recording as occupancy-grid frames at one fixed period."""

from __future__ import annotations

import hashlib
import math
import struct
from collections.abc import Callable, Iterable, Iterator, Mapping
from copy import copy
from functools import cached_property
from itertools import count, islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.errors import RecordingError
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec, LabelledFrame, Points, window_about
from gridtrack.common.notices import Notice
from gridtrack.common.scan import MAX_RATE_HZ, MIN_RATE_HZ, Scan
from gridtrack.recordings import Recording, open_recording
from gridtrack.recordings.observation import Observation, check_labels, frame_of, labelled_returns
from gridtrack.recordings.recording_info import Stretch, stretch_text
from gridtrack.recordings.resample import SensorPoses, Tick, resample_scans
from gridtrack.recordings.stretches import RecordedTime, parse_stretch, stretch_of
from gridtrack.recordings.survey import Survey

MAX_EMPTY_FRAMES = 6000
"""Limit of the empty frames in one gap: ten minutes at 10 Hz."""
LEAST_WINDOW_CELLS = 20
"""Cells along a side of the smallest default window."""
SLOW_SENSOR_RATIO = 1.5
"""A sensor is slow if its period is more than this many times the shortest one."""


def open_stream(
    text: str | Path,
    *,
    grid: GridSpec | None = None,
    rate_hz: float | None = None,
    points: Points = "centres",
    **options: Any,
) -> GridStream:
    """The stream of `RECORDING` or `RECORDING@STRETCH`; grid and rate default to the recording's.

    `options`: as in open_recording. Raises RecordingError, PluginError and ConfigurationError.
    """
    path, stretch = parse_stretch(str(text))
    recording = open_recording(path, **options)
    return GridStream(recording, stretch, grid=grid, rate_hz=rate_hz, points=points)


class GridStream:
    """A stretch of a recording as frames; every iteration starts at the first frame.

    The stamp of frame k of a recording is k periods after its first scan, in every stretch: a stretch is a slice of
    the whole. The window is centred on the first sensor: its axes are the world's, and it follows the sensor by whole
    cells. In a gap of that sensor it moves like the other sensors. `points` of the frames are the centres of the
    occupied cells, the same for every tracker, or with "raw" the returns of the laser.
    """

    def __init__(
        self,
        recording: Recording,
        stretch: Stretch | str | None = None,
        *,
        grid: GridSpec | None = None,
        rate_hz: float | None = None,
        points: Points = "centres",
    ) -> None:
        info, survey = recording.info, recording.survey
        self.recording = recording
        self.points = points
        self.sha256 = recording.sha256
        self.site = info.site
        self.classes = info.classes
        self.grid = grid or (GridSpec.parse(info.grid) if info.grid else default_grid(survey))
        self.period_ns = round(1e9 / _rate(recording, rate_hz))
        self.period_s = self.period_ns / 1e9
        self.stretch_s, self.name = stretch_of(recording, stretch)
        self._ticks = _ticks_in(self.stretch_s, survey.last_ns - survey.first_ns, self.period_ns)
        if not self._ticks:
            raise RecordingError(f"{self.name}: no frame at {1 / self.period_s:g} Hz in this stretch")
        recording.check_poses()
        self._check_longest_gap()
        self.gaps = self._count_gaps()
        if len(survey.sensors) > 1:
            stamps_ns = survey.first_ns + np.arange(self._ticks.start, self._ticks.stop) * self.period_ns
            slow = () if rate_hz or info.rate_hz else _slow_sensor(survey)
            for text in (*_missing_scans(survey, stamps_ns, self.period_s, self.stretch_s), *slow):
                recording.notify(text)
        self._degrade: Callable[[Scan], Scan] | None = None

    def degraded(self, degrade: Callable[[Scan], Scan]) -> GridStream:
        """The same stretch of scans degraded by `degrade`, at the same ticks."""
        other = copy(self)
        other._degrade = degrade
        return other

    def __len__(self) -> int:
        return len(self._ticks)

    def __iter__(self) -> Iterator[GridFrame]:
        return (observation.frame for observation in self.observations())

    @property
    def start_s(self) -> float:
        """The time of the first frame since the first scan of the recording, seconds."""
        return self._ticks[0] * self.period_s

    def stamp_ns(self, index: int) -> int:
        """The stamp of a frame of this stretch."""
        return self.recording.survey.first_ns + self._ticks[index] * self.period_ns

    @property
    def recorded(self) -> RecordedTime:
        """The time that the frames cover."""
        first_ns = self.recording.survey.first_ns
        start_ns, end_ns = (first_ns + tick * self.period_ns for tick in (self._ticks.start, self._ticks.stop))
        return RecordedTime(self.recording.source_sha256, self.site, start_ns, end_ns)

    @cached_property
    def has_truth(self) -> bool:
        """Whether the recording has the true scene."""
        return any(scan.scene is not None for scan in islice(self.recording.scans(), len(self.recording.survey.poses)))

    @property
    def has_people(self) -> bool:
        """Whether people are annotated in the stretch."""
        sensors = [sensor for sensor in self.recording.survey.sensors.values() if sensor.with_people]
        return any(one.people_ns[0] <= self.stamp_ns(-1) and one.people_ns[1] >= self.stamp_ns(0) for one in sensors)

    def observations(self) -> Iterator[Observation]:
        """The frames with their scans. For the referee only: no tracker receives one.

        The window follows the recorded poses, even if the scans are degraded.
        """
        return self._observed(self._resampled(), self._ticks.start)

    def arriving(self) -> Iterator[Observation]:
        """The observations of a recording that is still being written, from its first scan to the end of the file.

        Each is yielded as soon as its scans are read. Raises RecordingError for a gap that is too long.
        """
        return self._observed(self._arriving())

    def _arriving(self) -> Iterator[Tick]:
        origin_ns = newest_ns = self.recording.survey.first_ns
        ended = False

        def scans() -> Iterator[Scan]:
            nonlocal newest_ns, ended
            for scan in self.recording.scans():
                if scan.stamp_ns - newest_ns > MAX_EMPTY_FRAMES * self.period_ns:
                    raise RecordingError(f"{self.name}: no scans for {(scan.stamp_ns - newest_ns) / 1e9:.1f} s")
                newest_ns = max(newest_ns, scan.stamp_ns)
                yield scan
            ended = True

        alone = len(self.recording.survey.sensors) == 1
        for tick in resample_scans(scans(), self.period_ns, origin_ns=origin_ns, ticks=count(), bridged=alone):
            if ended and tick.stamp_ns > newest_ns:
                return
            yield tick

    def _observed(self, ticks: Iterable[Tick], first: int = 0) -> Iterator[Observation]:
        """The observations of `ticks`, beginning with tick `first` of the recording."""
        survey = self.recording.survey
        sensor_poses = SensorPoses(survey.poses)
        reference_T_world = SE2()
        for tick in ticks:
            poses = sensor_poses.at(tick.scans)
            scan = next((tick.scans[sensor] for sensor in poses if sensor in tick.scans), None)
            if scan is not None and scan.reference_T_sensor is not None:
                reference_T_world = scan.reference_T_sensor @ scan.world_T_sensor.inverse()
            if (tick.stamp_ns - survey.first_ns) // self.period_ns < first:
                continue
            window = window_about(next(iter(poses.values())), self.grid.cell_m)
            yield self._observation(tick, poses, window, reference_T_world)

    def _resampled(self) -> Iterator[Tick]:
        """The ticks of the stretch; if a sensor moves, also those since the last tick with a scan of each sensor."""
        survey, ticks = self.recording.survey, self._ticks
        if survey.moves:
            since = self._end_of_last_long_gap()
            stamps_ns = survey.first_ns + np.arange(since, ticks.start + 1) * self.period_ns
            missing = [sensor.missing(stamps_ns, self.period_ns) for sensor in survey.sensors.values()]
            complete = np.flatnonzero(~np.any(missing, axis=0))
            ticks = range(since + (int(complete[-1]) if len(complete) else 0), ticks.stop)
        margin_s = 3 * self.period_s
        start_s, end_s = ticks[0] * self.period_s, ticks[-1] * self.period_s
        scans = self.recording.scans(max(start_s - margin_s, 0.0), end_s + margin_s)
        alone = len(survey.sensors) == 1
        return resample_scans(scans, self.period_ns, origin_ns=survey.first_ns, ticks=ticks, bridged=alone)

    def _end_of_last_long_gap(self) -> int:
        """The first tick after the last gap of more than MAX_EMPTY_FRAMES before the stretch; it may last for years."""
        long_gaps = self.recording.survey.gaps(MAX_EMPTY_FRAMES * self.period_ns)
        ends = (long_gaps[:, 1] - self.recording.survey.first_ns) // self.period_ns
        return int(ends[ends <= self._ticks.start].max(initial=0))

    def _observation(
        self, tick: Tick, poses: Mapping[str, SE2], world_T_grid: SE2, reference_T_world: SE2
    ) -> Observation:
        """The observation of a tick; `poses` has all sensors, even those without a scan."""
        scans = tick.scans if self._degrade is None else {s: self._degrade(scan) for s, scan in tick.scans.items()}
        placed = {**poses, **{sensor: scan.world_T_sensor for sensor, scan in scans.items()}}
        grid_T_sensor = {
            sensor: SE2(pose.x - world_T_grid.x, pose.y - world_T_grid.y, pose.theta) for sensor, pose in placed.items()
        }
        frame = frame_of(tick.stamp_ns, scans, grid_T_sensor, world_T_grid, self.grid, self.points)
        time_s = (tick.stamp_ns - self.recording.survey.first_ns) / 1e9
        own = tuple(grid_T_sensor[sensor] for sensor in scans)
        return Observation(frame, tuple(scans.values()), own, time_s, reference_T_world)

    @cached_property
    def first_move_s(self) -> float | None:
        """The time of the window's first motion in the stretch, seconds since the first scan; None without motion."""
        if not self.recording.survey.moves:
            return None
        observations = self.observations()
        window = next(observations).frame.world_T_grid
        return next((one.time_s for one in observations if one.frame.world_T_grid != window), None)

    def before(self, most: int) -> Iterator[Observation]:
        """At most `most` observations directly before the stretch. For the referee only."""
        earlier = copy(self)
        earlier._ticks = range(max(0, self._ticks.start - most), self._ticks.start)
        return earlier.observations() if earlier._ticks else iter(())

    def labelled(self) -> Iterator[LabelledFrame]:
        """The frames with the classes of their occupied cells, for training. A tracker in a trial receives no labels.

        Raises RecordingError for a label without a class.
        """
        for observation in self.observations():
            cells, labels = labelled_returns(observation.scans, observation.grid_T_sensor, self.grid)
            check_labels(labels, self.classes, observation.time_s)
            yield LabelledFrame(observation.frame, cells, labels)

    def all_observations(self) -> Iterator[Observation]:
        """The observations of the whole recording on the same grid and period, except in the longest gaps."""
        survey, period_s = self.recording.survey, self.period_s
        long_gaps = (survey.gaps(MAX_EMPTY_FRAMES * self.period_ns) - survey.first_ns) / 1e9
        starts = [0.0, *(end_s - period_s for _, end_s in long_gaps)]
        ends = [*(start_s + period_s for start_s, _ in long_gaps), None]
        for part in zip(starts, ends, strict=True):
            stream = GridStream(self.recording, part, grid=self.grid, rate_hz=1e9 / self.period_ns)
            yield from stream.observations()

    def _check_longest_gap(self) -> None:
        """Raise RecordingError for a gap in the stretch of more than MAX_EMPTY_FRAMES frames."""
        survey = self.recording.survey
        first_ns, last_ns = (survey.first_ns + tick * self.period_ns for tick in (self._ticks[0], self._ticks[-1]))
        for start_ns, end_ns in survey.gaps(MAX_EMPTY_FRAMES * self.period_ns).tolist():
            frames = (min(end_ns, last_ns) - max(start_ns, first_ns)) // self.period_ns
            if frames > MAX_EMPTY_FRAMES:
                start_s, end_s = ((at_ns - survey.first_ns) / 1e9 for at_ns in (start_ns, end_ns))
                raise RecordingError(
                    f"{self.name}: no scans from {start_s:.1f} s to {end_s:.1f} s, {frames} empty frames where at most"
                    f" {MAX_EMPTY_FRAMES} are allowed: name a stretch before or after it"
                    f" ({self.recording.path}@0s-{math.floor(start_s * 10) / 10:g}s,"
                    f" {self.recording.path}@{math.ceil(end_s * 10) / 10:.10g}s-)"
                )

    def _count_gaps(self) -> int:
        """The number of gaps in the stretch longer than two periods; with a single sensor they are a warning."""
        survey = self.recording.survey
        start_ns = survey.first_ns + self._ticks[0] * self.period_ns
        end_ns = survey.first_ns + self._ticks[-1] * self.period_ns
        gaps = [
            gap
            for sensor in survey.sensors.values()
            for gap in sensor.gaps(self.period_ns)
            if gap[1] > start_ns and gap[0] < end_ns
        ]
        if gaps and len(survey.sensors) == 1:
            longest = max(gaps, key=lambda gap: int(gap[1] - gap[0]))
            longest_s = round((longest[1] - longest[0]) / 1e9, 2)
            self.recording.notify(
                Notice(
                    text=f"gaps longer than two periods of {self.period_s:g} s in {stretch_text(self.stretch_s)}:"
                    f" {len(gaps)}, the longest {longest_s:.2f} s from"
                    f" {(longest[0] - survey.first_ns) / 1e9:.2f} s on; frames in them are empty",
                    kind="{} gaps between scans, the longest {} s; frames in them are empty",
                    values=(len(gaps), longest_s),
                )
            )
        return len(gaps)


def default_grid(survey: Survey) -> GridSpec:
    """The default window of a recording: GridSpec's, with fewer cells if no sensor measures as far."""
    usual, centre = GridSpec(), next(iter(survey.poses.values()))
    reach_m = max(
        sensor.first.range_max + math.hypot(pose.x - centre.x, pose.y - centre.y)
        for sensor, pose in zip(survey.sensors.values(), survey.poses.values(), strict=True)
    )
    cells = 2 * math.ceil(round(min(reach_m, usual.size * usual.cell_m) / usual.cell_m, 3))
    return GridSpec(min(max(cells, LEAST_WINDOW_CELLS), usual.size), usual.cell_m)


def _ticks_in(stretch_s: Stretch, duration_ns: int, period_ns: int) -> range:
    """Numbers of the ticks in the stretch: its start included, its end excluded unless the recording ends there."""
    start_s, end_s = stretch_s
    end = duration_ns // period_ns + 1
    if end_s is not None and round(end_s * 1e9) < duration_ns:
        end = min(end, -(-round(end_s * 1e9) // period_ns))
    return range(-(-round(start_s * 1e9) // period_ns), end)


def _rate(recording: Recording, rate_hz: float | None) -> float:
    rate = rate_hz or recording.info.rate_hz or recording.survey.rate_hz
    if rate is None:
        texts, remedy = recording.warning_texts(), recording.stamp_remedy
        reason = next((text for text in texts if remedy and remedy in text), "give one with --rate")
        raise RecordingError(f"{recording.path}: a single scan has no rate: {reason}")
    if not MIN_RATE_HZ <= rate <= MAX_RATE_HZ:
        raise RecordingError(f"{recording.path}: a rate of {rate:g} Hz; expected {MIN_RATE_HZ:g} to {MAX_RATE_HZ:g} Hz")
    return rate


def frame_digest(frame: GridFrame) -> bytes:
    """A hash of the content of a frame, 32 bytes, to check that two trackers received the same frame."""
    digest = hashlib.blake2b(digest_size=32)
    pose = frame.world_T_grid
    digest.update(struct.pack("<qddd", frame.stamp_ns, pose.x, pose.y, pose.theta))
    digest.update(struct.pack("<QQ", len(frame.origins), len(frame.points)))
    for array, kind in (
        (np.packbits(frame.visible), "u1"),
        (np.packbits(frame.occupied), "u1"),
        (frame.origins, "<f4"),
        (frame.points, "<f4"),
        (frame.point_origin, "u1"),
    ):
        digest.update(np.ascontiguousarray(array, kind).tobytes())
    return digest.digest()


def _missing_scans(survey: Survey, stamps_ns: NDArray[np.int64], period_s: float, stretch_s: Stretch) -> Iterator[str]:
    """A line for each sensor that has no scan for some of the frames at `stamps_ns` (n,)."""
    for name, sensor in survey.sensors.items():
        missing = sensor.missing(stamps_ns, period_s * 1e9)
        if missing.any():
            first_s = (stamps_ns[missing.argmax()] - survey.first_ns) / 1e9
            yield (
                f"sensor '{name}': no scan within {period_s / 2:g} s of {missing.sum()} of"
                f" {len(missing)} frames in {stretch_text(stretch_s)}, the first at {first_s:.2f} s; they are"
                " made from the scans of the other sensors"
            )


def _slow_sensor(survey: Survey) -> Iterator[str]:
    """A line if the slowest sensor, which sets the rate of the frames, is so slow that other scans are not used."""
    periods_s = {name: sensor.period_s for name, sensor in survey.sensors.items() if sensor.period_s}
    if len(periods_s) < 2:
        return
    slow, fast = (end(periods_s, key=periods_s.__getitem__) for end in (max, min))
    if periods_s[slow] > SLOW_SENSOR_RATIO * periods_s[fast]:
        yield (
            f"the slowest sensor sets the rate of the frames: '{slow}' has {1 / periods_s[slow]:.3g} scans a second,"
            f" '{fast}' {1 / periods_s[fast]:.3g}; --rate {1 / periods_s[fast]:.3g} makes more frames, most of them"
            f" without '{slow}'"
        )
