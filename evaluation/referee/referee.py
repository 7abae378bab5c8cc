"""The referee: delivers the frames of a stretch to a tracker, and pairs each forecast with the observed frames.

A tracker receives past frames only. Memory is bounded by one horizon of frames and the forecasts within it, whatever
the length of the stretch; moments of a short stretch are kept for the next tracker, up to MOST_KEPT_BYTES.
"""

from __future__ import annotations

import hashlib
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.errors import RecordingError
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame
from gridtrack.evaluation.referee.kinds import Regions
from gridtrack.evaluation.referee.motion import MotionFinder, ObservedMotion, ReturnsInMotion, parts_of
from gridtrack.evaluation.referee.people import people_in
from gridtrack.evaluation.referee.strata import LastSeen, RegionMaps
from gridtrack.evaluation.referee.targets import Target, target_of
from gridtrack.recordings.observation import Observation
from gridtrack.recordings.recording_info import stretch_text
from gridtrack.recordings.stream import GridStream, frame_digest
from gridtrack.recordings.survey import MIN_REST_S
from gridtrack.trackers.contract import Forecast, FrameSource

WARM_UP = 20
"""Frames at the start of a stretch that are delivered and not scored."""
MOST_KEPT_BYTES = 1 << 27
"""Limit of the moments of one stretch that are kept: a minute of a laser with a thousand beams in 100 x 100 cells has
two thirds of it."""
_CELL_BYTES, _BEAM_BYTES = 12, 64
"""Memory that a moment takes for a cell of its window and a beam of its scans, with its target."""
_Counts = TypeVar("_Counts")


class TrackerLike(Protocol):
    """The methods of a tracker that the referee calls, in the tracker's process or in this one."""

    def reset(self, seed: int) -> None: ...  # noqa: D102

    def update(self, frame: GridFrame) -> None: ...  # noqa: D102

    def predict(self, steps: int) -> Forecast: ...  # noqa: D102


@dataclass(frozen=True, slots=True)
class Schedule:
    """The frames that are forecast from, of a stretch of `frames` frames: the same for every tracker.

    Every `every`-th frame after the first `warm_up` ones whose `steps` following frames lie inside the stretch.
    """

    frames: int
    steps: int
    every: int
    warm_up: int = WARM_UP

    def due(self, index: int) -> bool:
        """Whether to forecast after the frame `index` (0-based) has been delivered."""
        return index in self.scored

    @property
    def scored(self) -> range:
        """The frames that are forecast from."""
        return range(self.warm_up, self.frames - self.steps, self.every)

    @property
    def expected(self) -> int:
        """Number of frames scored in a complete trial."""
        return len(self.scored)


@dataclass(frozen=True, slots=True)
class ScoredForecast:
    """A forecast made at frame t, and the observed `targets` t..t+steps in the window of frame t.

    Of each cell of that window `region_maps` has the regions, and `ages` (M, M) the age band at t;
    `reference_T_grid` is its pose in the world of the reference poses.
    """

    forecast: Forecast
    targets: tuple[Target, ...]
    region_maps: RegionMaps
    ages: NDArray[np.uint8]
    reference_T_grid: SE2 = field(default_factory=SE2)
    _counted: dict[Any, Any] = field(default_factory=dict, repr=False, compare=False)

    def once(self, count: Callable[[ScoredForecast], _Counts]) -> _Counts:
        """`count` of this forecast, made once: several scores follow from the same counts."""
        if count not in self._counted:
            self._counted[count] = count(self)
        found: _Counts = self._counted[count]
        return found

    @property
    def occupancy(self) -> NDArray[np.float32]:
        """P(occupied) (steps+1, M, M) as it is scored: a visible cell without a forecast (NaN) is wrong, 0 if it is
        occupied and 1 if it is free."""
        return self.once(_without_gaps)

    @property
    def missing(self) -> bool:
        """Whether there is no forecast of this frame: NaN in all cells."""
        return bool(np.isnan(self.forecast.occupancy).all())

    @property
    def frames(self) -> tuple[GridFrame, ...]:
        """The frames t..t+steps in the window of frame t."""
        return tuple(target.frame for target in self.targets)

    @property
    def stamp_ns(self) -> int:
        """Stamp of frame t, at which the forecast was made."""
        return self.targets[0].frame.stamp_ns


def _without_gaps(scored: ScoredForecast) -> NDArray[np.float32]:
    occupancy = scored.forecast.occupancy
    gaps = np.isnan(occupancy)
    if not gaps.any():
        return occupancy
    occupied = np.stack([target.state & 1 for target in scored.targets]).astype(np.bool_)
    return np.where(gaps, np.where(occupied, np.float32(0.0), np.float32(1.0)), occupancy)


def scored_forecasts(
    tracker: TrackerLike, stream: Iterable[Moment], schedule: Schedule, seed: int
) -> Iterator[ScoredForecast]:
    """Stream `stream` through the tracker, and yield each scheduled forecast when its last frame is observed.

    Raises RecordingError if a target cannot be made.
    """
    tracker.reset(seed)
    recent: deque[Moment] = deque(maxlen=schedule.steps + 1)
    pending: deque[tuple[int, Forecast, NDArray[np.uint8]]] = deque()
    last_seen = LastSeen()
    for index, moment in enumerate(stream):
        recent.append(moment)
        last_seen.add(moment.frame, moment.cell_m)
        tracker.update(moment.frame)
        if schedule.due(index):
            ages = last_seen.bands(moment.frame.stamp_ns)
            pending.append((index + schedule.steps, tracker.predict(schedule.steps), ages))
        if pending and pending[0][0] == index:
            _, forecast, ages = pending.popleft()
            window, maps = recent[0].window, recent[0].region_maps
            targets = tuple(one.target_in(window, maps) for one in recent)
            yield ScoredForecast(forecast, targets, maps, ages, window)


class Delivery:
    """The moments of a stretch, counted and hashed as their frames are delivered to a tracker."""

    def __init__(self, delivered: Iterable[Moment], on_frame: Callable[[], None]) -> None:
        """`on_frame()` is called before each frame; an error that it raises ends the delivery."""
        self.frames = 0
        self._delivered = delivered
        self._on_frame = on_frame
        self._hash = hashlib.blake2b(digest_size=16)

    def __iter__(self) -> Iterator[Moment]:
        """The moments, once."""
        for moment in self._delivered:
            self._on_frame()
            self._hash.update(frame_digest(moment.frame))
            self.frames += 1
            yield moment

    @property
    def digest(self) -> str:
        """Hash of every frame delivered so far, in their order: 32 hexadecimal digits."""
        return self._hash.hexdigest()


def refuse_moving(stream: GridStream, tracker: str) -> None:
    """Raise RecordingError if the sensor moves in the stretch: `tracker` follows only a sensor at rest."""
    if stream.first_move_s is None:
        return
    rest = stream.recording.survey.longest_rest_s(2.0 * stream.period_s)
    remedy = (
        f": name a stretch in which it is at rest, such as {stream.recording.path}@{stretch_text(rest)}"
        if rest is not None
        else f", and this one is at rest nowhere for {MIN_REST_S:g} s"
    )
    raise RecordingError(
        f"{stream.name}: the sensor moves at {stream.first_move_s:.3f} s, and '{tracker}' follows only a sensor at rest"
        f" (moving_sensor is false){remedy}"
    )


class Moment:
    """One observed frame of a `source` with these `regions`; `in_motion` of its returns."""

    def __init__(
        self, observation: Observation, in_motion: ReturnsInMotion, source: FrameSource, regions: Regions
    ) -> None:
        self.observation = observation
        """For the referee only: no tracker receives one."""
        self._in_motion, self._source, self._regions = in_motion, source, regions
        self._newest: tuple[SE2, RegionMaps, Target] | None = None

    @property
    def frame(self) -> GridFrame:
        """The frame as a tracker receives it."""
        return self.observation.frame

    @property
    def cell_m(self) -> float:
        """Side of a cell, metres."""
        return self._source.grid.cell_m

    @property
    def window(self) -> SE2:
        """`reference_T_grid` of the frame."""
        return self.observation.reference_T_grid

    @cached_property
    def region_maps(self) -> RegionMaps:
        """The regions of the cells of the frame's own window. Raises RecordingError."""
        return self._regions.of(self.observation)

    def target_in(self, window: SE2, region_maps: RegionMaps) -> Target:
        """The target in the window of a forecast with these regions of cells. Raises RecordingError."""
        newest = self._newest
        # the regions of a window change with time too (`observed_kinds.BLOCK_NS`)
        if newest is None or newest[0] != window or newest[1] is not region_maps:
            grid = self._source.grid
            seen = self.observation.seen_in(window, grid)
            moving = self._in_motion.among(seen, grid)
            motion = parts_of(moving, seen.frame.occupied, region_maps.dynamic, grid)
            bodies = self._in_motion.bodies
            target = target_of(seen, grid, self._source.classes, motion, bodies)
            target = replace(target, people=people_in(seen, grid, region_maps.dynamic))
            self._newest = newest = window, region_maps, target
        return newest[2]

    @property
    def target(self) -> Target:
        """The target in the frame's own window. Raises RecordingError."""
        return self.target_in(self.window, self.region_maps)


@runtime_checkable
class Observed(Protocol):
    """A source that has observations, and not only frames."""

    def observations(self) -> Iterator[Observation]: ...  # noqa: D102


def moments(
    stream: FrameSource,
    regions: Regions,
    observations: Iterable[Observation] | None = None,
    motion: MotionFinder | None = None,
) -> Iterator[Moment]:
    """The frames of a stretch as moments; with the truth and labels that its source has.

    `observations` are those of its frames, and `motion` finds returns in motion in them; None: by the stream itself.
    """
    found = motion or ObservedMotion(stream)
    if observations is None:
        observations = stream.observations() if isinstance(stream, Observed) else map(Observation, stream)
    return (Moment(observation, found.of(observation), stream, regions) for observation in observations)


class KeptMoments:
    """The moments of a stretch, for one tracker after the other. Thread-safe.

    The first pass to its end keeps them, and their targets, for the next ones, if they take at most MOST_KEPT_BYTES:
    reading, rendering and targets take ten times as long as the rest of the work between two forecasts.
    """

    def __init__(self, stream: GridStream, regions: Regions) -> None:
        self.stream, self.regions = stream, regions
        self._kept: tuple[Moment, ...] | None = None
        self._keeping = threading.Lock()
        """Held by the pass that keeps them, so that passes at the same time keep them once."""

    def __iter__(self) -> Iterator[Moment]:
        """The moments, from the first on."""
        if self._kept is not None:
            yield from self._kept
        elif self._keeping.acquire(blocking=False):
            try:
                yield from self._read()
            finally:
                self._keeping.release()
        else:
            yield from moments(self.stream, self.regions)

    def _read(self) -> Iterator[Moment]:
        """The moments; after the last one they are kept if they are small enough."""
        kept: list[Moment] = []
        room = MOST_KEPT_BYTES
        for number, moment in enumerate(moments(self.stream, self.regions)):
            size = _size_of(moment)
            if number == 0 and size * len(self.stream) > room:
                room = 0
            room -= size
            if room >= 0:
                kept.append(moment)
            else:
                kept.clear()
            yield moment
        if room >= 0:
            self._kept = tuple(kept)


def _size_of(moment: Moment) -> int:
    """About the bytes that a moment takes with its target."""
    beams = sum(scan.ranges.size for scan in moment.observation.scans)
    return _CELL_BYTES * moment.frame.visible.size + _BEAM_BYTES * beams
