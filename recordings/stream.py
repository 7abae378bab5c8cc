"""The grid stream: a stretch of a recording as occupancy-grid frames at one fixed period."""

from __future__ import annotations

import hashlib
import math
import re
import struct
from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.errors import RecordingError, did_you_mean
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec, LabelledFrame, Points
from gridtrack.common.names import NAME_RULE, is_name
from gridtrack.common.raycast import cast_scan
from gridtrack.common.scan import MAX_RATE_HZ, MIN_RATE_HZ, Scan
from gridtrack.common.scene import Scene
from gridtrack.recordings import Recording, open_recording
from gridtrack.recordings.cell_labels import check_labels, labelled_returns
from gridtrack.recordings.recorded_time import RecordedTime
from gridtrack.recordings.recording import Stretch, stretch_text
from gridtrack.recordings.resample import Tick, resample_scans

MAX_EMPTY_FRAMES = 6000
"""Limit of the empty frames in one gap: ten minutes at 10 Hz."""


def parse_stretch(text: str) -> tuple[Path, Stretch | str | None]:
    """Read `demo.mcap`, `demo.mcap@30s-90s`, `demo.mcap@90s-` or `demo.mcap@test`: a path and a stretch of it.

    Raises RecordingError.
    """
    path, at, stretch = text.rpartition("@")
    if not at or Path(text).exists():
        return Path(text), None
    if not path or not stretch:
        raise RecordingError(f"'{text}': expected RECORDING, RECORDING@30s-90s or RECORDING@NAME")
    if not is_name(stretch):
        raise RecordingError(f"'{text}': no such recording, and '{stretch}' is not the name of a stretch: {NAME_RULE}")
    return Path(path), _seconds(stretch, text) or stretch


def parse_named_stretch(text: str) -> tuple[str, Stretch]:
    """Read `train=0s-75s` or `test=90s-`: a name for a stretch, and the stretch. Raises RecordingError."""
    name, _, stretch = text.partition("=")
    seconds = _seconds(stretch, text)
    if not name or seconds is None:
        raise RecordingError(f"'{text}': expected NAME=30s-90s, or NAME=90s- to the end")
    if not is_name(name):
        raise RecordingError(f"'{text}': '{name}' cannot be the name of a stretch: {NAME_RULE}")
    return name, seconds


def _seconds(stretch: str, where: str) -> Stretch | None:
    """`30s-90s` or `90s-` as (start, end); None for a text that is not a range of seconds."""
    seconds = re.fullmatch(r"(\d+(?:\.\d*)?)s?-(?:(\d+(?:\.\d*)?)s?)?", stretch)
    if seconds is None:
        return None
    start_s, end_s = float(seconds[1]), float(seconds[2]) if seconds[2] else None
    if end_s is not None and end_s <= start_s:
        raise RecordingError(f"'{where}': a stretch ends after it starts")
    return start_s, end_s


def open_stream(
    text: str | Path,
    *,
    grid: GridSpec | None = None,
    rate_hz: float | None = None,
    points: Points = "centres",
    topic: str | None = None,
    strict: bool = False,
) -> GridStream:
    """The stream of `RECORDING` or `RECORDING@STRETCH`; grid and rate default to those of the recording.

    Raises RecordingError.
    """
    path, stretch = parse_stretch(str(text))
    recording = open_recording(path, topic=topic, strict=strict)
    return GridStream(recording, stretch, grid=grid, rate_hz=rate_hz, points=points)


@dataclass(frozen=True, slots=True)
class Observation:
    """A frame and the `scans` it was made of, with labels and truth, for the referee only.

    `grid_T_sensor` are the poses of the scans' sensors in the frame's grid, in the same order; `time_s` is the time
    since the first scan of the recording.
    """

    frame: GridFrame
    scans: tuple[Scan, ...] = ()
    grid_T_sensor: tuple[SE2, ...] = ()
    time_s: float = 0.0

    @property
    def scene(self) -> Scene | None:
        """The true scene, where the recording has it."""
        return next((scan.scene for scan in self.scans if scan.scene is not None), None)


class GridStream:
    """A stretch of a recording as frames; every iteration starts at the first frame.

    The stamp of frame k of a recording is k periods after its first scan, in every stretch: a stretch is a slice of
    the whole. The grid frame is that of the first sensor at its first scan; where a sensor moves, the grid follows the
    first sensor. `points` of the frames are the centres of the occupied cells, the same for every tracker, or with
    "raw" the returns of the laser.
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
        self.grid = grid or (GridSpec.parse(info.grid) if info.grid else GridSpec())
        self.period_ns = round(1e9 / _rate(recording, rate_hz))
        self.period_s = self.period_ns / 1e9
        self.stretch_s, self.name = _stretch(recording, stretch)
        self._ticks = _ticks(survey.last_ns - survey.first_ns, self.period_ns, self.stretch_s)
        if not self._ticks:
            raise RecordingError(f"{self.name}: no frame at {1 / self.period_s:g} Hz in this stretch")
        recording.check_mounting()
        self._check_longest_gap()
        self.gaps = self._count_gaps()
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

    def observations(self) -> Iterator[Observation]:
        """The frames with the scans they were made of. For the referee only: no tracker receives one."""
        survey = self.recording.survey
        margin_s = 3 * self.period_s
        start_s, end_s = self._ticks[0] * self.period_s, self._ticks[-1] * self.period_s
        scans = self.recording.scans(max(start_s - margin_s, 0.0), end_s + margin_s)
        if self._degrade is not None:
            scans = map(self._degrade, scans)
        poses = dict(survey.poses)
        reference = next(iter(poses))
        world_T_grid = poses[reference]
        for tick in resample_scans(scans, self.period_ns, origin_ns=survey.first_ns, ticks=self._ticks):
            poses.update({sensor: scan.world_T_sensor for sensor, scan in tick.scans.items()})
            if survey.moves:
                world_T_grid = poses[reference]
            grid_T_world = world_T_grid.inverse()
            # The sensor that defines the grid frame is at its origin exactly, without rounding errors.
            grid_T_sensor = {s: SE2() if pose == world_T_grid else grid_T_world @ pose for s, pose in poses.items()}
            frame = self._frame(tick, grid_T_sensor, world_T_grid)
            time_s = (tick.stamp_ns - survey.first_ns) / 1e9
            yield Observation(frame, tuple(tick.scans.values()), tuple(grid_T_sensor[s] for s in tick.scans), time_s)

    def before(self, count: int) -> Iterator[GridFrame]:
        """The frames of the recording directly before the stretch, at most `count`. For the referee only."""
        earlier = copy(self)
        earlier._ticks = range(max(0, self._ticks.start - count), self._ticks.start)
        return iter(earlier) if earlier._ticks else iter(())

    def labelled(self) -> Iterator[LabelledFrame]:
        """The frames with the classes of their occupied cells, for training. A tracker in a trial receives none.

        Raises RecordingError for a label without a class.
        """
        for observation in self.observations():
            cells, labels = labelled_returns(observation.scans, observation.grid_T_sensor, self.grid)
            check_labels(labels, self.classes, observation.time_s)
            yield LabelledFrame(observation.frame, cells, labels)

    def _frame(self, tick: Tick, grid_T_sensor: dict[str, SE2], world_T_grid: SE2) -> GridFrame:
        visible, occupied = np.zeros(self.grid.shape, np.bool_), np.zeros(self.grid.shape, np.bool_)
        owner = np.zeros(self.grid.shape, np.uint8)
        returns: list[NDArray[np.float32]] = []
        return_origin: list[NDArray[np.uint8]] = []
        for s, sensor in enumerate(grid_T_sensor):
            if sensor not in tick.scans:
                continue
            before = occupied.copy()
            returns.append(cast_scan(tick.scans[sensor], self.grid, grid_T_sensor[sensor], visible, occupied))
            return_origin.append(np.full(len(returns[-1]), s, np.uint8))
            owner[occupied & ~before] = s
        if self.points == "raw" and returns:
            points, point_origin = np.concatenate(returns), np.concatenate(return_origin)
        else:
            points, point_origin = self.grid.cell_centres(occupied), owner[occupied]
        origins = np.array([(pose.x, pose.y) for pose in grid_T_sensor.values()], np.float32)
        return GridFrame(tick.stamp_ns, visible, occupied, world_T_grid, origins, points, point_origin)

    def all_frames(self) -> Iterator[GridFrame]:
        """The frames of the whole recording on the same grid and period, those in the longest gaps left out."""
        survey, period_s = self.recording.survey, self.period_s
        long_gaps = (survey.gaps(MAX_EMPTY_FRAMES * self.period_ns) - survey.first_ns) / 1e9
        starts = [0.0, *(end_s - period_s for _, end_s in long_gaps)]
        ends = [*(start_s + period_s for start_s, _ in long_gaps), None]
        for part in zip(starts, ends, strict=True):
            yield from GridStream(self.recording, part, grid=self.grid, rate_hz=1e9 / self.period_ns)

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
        """Gaps of a sensor longer than two periods within the stretch; adds a warning to the recording."""
        survey = self.recording.survey
        start_ns = survey.first_ns + self._ticks[0] * self.period_ns
        end_ns = survey.first_ns + self._ticks[-1] * self.period_ns
        gaps = [
            gap
            for sensor in survey.sensors.values()
            for gap in sensor.gaps(self.period_ns)
            if gap[1] > start_ns and gap[0] < end_ns
        ]
        if gaps:
            longest = max(gaps, key=lambda gap: int(gap[1] - gap[0]))
            self.recording.notify(
                f"gaps longer than two periods of {self.period_s:g} s in {stretch_text(self.stretch_s)}: {len(gaps)},"
                f" the longest {(longest[1] - longest[0]) / 1e9:.2f} s from"
                f" {(longest[0] - survey.first_ns) / 1e9:.2f} s on; frames in them are empty"
            )
        return len(gaps)


def _rate(recording: Recording, rate_hz: float | None) -> float:
    rate = rate_hz or recording.info.rate_hz or recording.survey.rate_hz
    if rate is None:
        raise RecordingError(f"{recording.path}: a single scan has no rate: give one with --rate")
    if not MIN_RATE_HZ <= rate <= MAX_RATE_HZ:
        raise RecordingError(f"{recording.path}: a rate of {rate:g} Hz; expected {MIN_RATE_HZ:g} to {MAX_RATE_HZ:g} Hz")
    return rate


def _stretch(recording: Recording, stretch: Stretch | str | None) -> tuple[Stretch, str]:
    """The stretch in seconds, with its end, and its name for messages. Raises RecordingError."""
    duration_s = recording.survey.duration_s
    if stretch is None:
        return (0.0, duration_s), recording.name
    if isinstance(stretch, str):
        if stretch not in recording.info.stretches:
            known = did_you_mean(stretch, recording.info.stretches)
            raise RecordingError(f"{recording.path}: no stretch '{stretch}'; {known} (or seconds: {_whole(recording)})")
        start_s, end_s = recording.info.stretches[stretch]
        name, runs = f"{recording.name}@{stretch}", f" ({stretch_text((start_s, end_s))})"
    else:
        name, runs, (start_s, end_s) = f"{recording.name}@{stretch_text(stretch)}", "", stretch
    if start_s > duration_s or (end_s is not None and end_s > math.ceil(duration_s)):
        long = f"{duration_s:.1f} s long" + (f" ({recording.damage})" if recording.damage else "")
        raise RecordingError(f"{name}{runs}: the recording is {long}: name a range inside it ({_whole(recording)})")
    return (start_s, duration_s if end_s is None else end_s), name


def _whole(recording: Recording) -> str:
    """The whole recording as RECORDING@range."""
    return f"{recording.path}@{stretch_text((0.0, recording.survey.whole_s))}"


def _ticks(duration_ns: int, period_ns: int, stretch_s: Stretch) -> range:
    """Numbers of the ticks in the stretch: its start included, its end excluded unless the recording ends there."""
    start_s, end_s = stretch_s
    end = duration_ns // period_ns + 1
    if end_s is not None and round(end_s * 1e9) < duration_ns:
        end = min(end, -(-round(end_s * 1e9) // period_ns))
    return range(-(-round(start_s * 1e9) // period_ns), end)


def frame_digest(frame: GridFrame) -> bytes:
    """A hash of the content of a frame, 32 bytes: equal for two trackers that received the same frame."""
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
