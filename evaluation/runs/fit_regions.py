"""Regions for the score of a training: the referee's, for whole stretches, as files.

The command finds them, because static outlines and speeds are truth that `fit` does not receive. They are found once
for each scored stretch, so every tracker, and every part of a stretch, is scored on the same cells.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.errors import RecordingError
from gridtrack.common.files import atomic_write
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec, Mask
from gridtrack.common.scan import Scan
from gridtrack.evaluation.referee.kinds import (
    KindsOfPlaces,
    KindsOfTimes,
    KindsOfWindow,
    Regions,
    StaticTiles,
    WorldCells,
    kinds_of_outlines,
    observed_kinds,
)
from gridtrack.evaluation.referee.motion import ObservedMotion
from gridtrack.evaluation.referee.referee import Schedule, moments, scored_forecasts
from gridtrack.evaluation.referee.strata import STRATA
from gridtrack.evaluation.scores.cells import Tally, count_cells
from gridtrack.evaluation.scores.contact_foresight import CONTACT_FORESIGHT
from gridtrack.evaluation.scores.definition import TrialFacts, divided
from gridtrack.evaluation.scores.f1 import f1_of
from gridtrack.evaluation.scores.thresholds import best_thresholds, half
from gridtrack.recordings.observation import Observation, cells_in_window, reference_pose
from gridtrack.recordings.stream import GridStream
from gridtrack.trackers.contract import FrameSource, StretchScore, Tracker

StoredKinds = KindsOfWindow | KindsOfPlaces | KindsOfTimes
"""Kinds that a file can hold."""


def cell_kinds_for(stream: GridStream, streams: Iterable[GridStream]) -> StoredKinds:
    """Kinds of the cells of `stream`, one of the `streams` of a training. Raises RecordingError.

    Static cells are from the true scene. Without truth they are found in the training's own stretches of the
    recording only: the rest of the recording may be scored later.
    """
    first = next(iter(stream.observations()))
    if first.scene is not None:
        at_rest = not stream.recording.survey.moves and first.reference_T_world == SE2()
        windows = (one.reference_T_grid for one in ((first,) if at_rest else stream.observations()))
        return kinds_of_outlines(first.scene, windows, stream.grid)
    given = [other for other in streams if other.sha256 == stream.sha256 and other.grid == stream.grid]
    return observed_kinds(_each_frame_once(given), stream.grid)


def _each_frame_once(streams: Iterable[GridStream]) -> Iterator[Observation]:
    """The frames of stretches of one recording in the order of their stamps, also if stretches overlap."""
    newest_ns = None
    for stream in sorted(streams, key=lambda one: one.stretch_s[0]):
        for observation in stream.observations():
            if newest_ns is None or observation.frame.stamp_ns > newest_ns:
                newest_ns = observation.frame.stamp_ns
                yield observation


def store_regions(stream: GridStream, kinds: StoredKinds, path: Path) -> Path:
    """Write the regions of `stream`, with these `kinds` of its cells, to the .npz file `path`; returns `path`.

    Raises RecordingError, OSError.
    """
    motion, moves = ObservedMotion(stream), stream.first_move_s is not None
    scans: list[list[tuple[NDArray[np.float32], tuple[float, ...]]]] = []
    stamps_ns: list[int] = []
    moving: list[NDArray[np.int64]] = []
    reference_T_world: list[tuple[float, float, float]] = []
    for observation in stream.observations():
        pose = observation.reference_T_world
        stamps_ns.append(observation.frame.stamp_ns)
        moving.append(np.flatnonzero(motion.of(observation).among(observation, stream.grid)))
        reference_T_world.append((pose.x, pose.y, pose.theta))
        scans.append([(scan.ranges, _geometry(scan)) for scan in observation.scans] if moves else [])
    ranges, geometry = [own for frame in scans for own, _ in frame], [own for frame in scans for _, own in frame]
    with atomic_write(path) as file:
        np.savez_compressed(
            file,
            sha256=np.array(stream.sha256),
            grid=np.array(str(stream.grid)),
            moves=np.array(moves),
            stamps_ns=np.array(stamps_ns, np.int64),
            starts=np.cumsum([0, *map(len, moving)]),
            moving=np.concatenate([np.zeros(0, np.int64), *moving]).astype(np.int32),
            reference_T_world=np.array(reference_T_world),
            **_kinds_arrays(kinds),
            scan_starts=np.cumsum([0, *map(len, scans)]),
            range_starts=np.cumsum([0, *map(len, ranges)]),
            ranges=np.concatenate([np.zeros(0, np.float32), *ranges]),
            geometry=np.array(geometry, np.float64).reshape(-1, 7),
        )
    return path


def _geometry(scan: Scan) -> tuple[float, ...]:
    """The angle of the first beam, that between beams, the range limits, and the reference pose."""
    pose = reference_pose(scan)
    return scan.angle_min, scan.angle_increment, scan.range_min, scan.range_max, pose.x, pose.y, pose.theta


def _kinds_arrays(kinds: StoredKinds) -> dict[str, Any]:
    if isinstance(kinds, KindsOfWindow):
        return {"cell_kinds": kinds.cell_kinds}
    if isinstance(kinds, KindsOfTimes):
        times = {(block, *place): tile for block, tiles in kinds.static.items() for place, tile in tiles.items()}
        return {
            "blocks": np.array(list(kinds.static), np.int64),
            "places": np.array(list(times), np.int64).reshape(-1, 3),
            "bits": np.array(list(times.values()), np.uint8),
        }
    tiles = kinds.static.tiles
    return {"places": np.array(list(tiles), np.int64), "static": np.stack([tile[0] for tile in tiles.values()])}


def _kinds_from(stored: Mapping[str, NDArray[Any]], grid: GridSpec) -> StoredKinds:
    if "cell_kinds" in stored:
        return KindsOfWindow(stored["cell_kinds"])
    if "blocks" in stored:
        times: dict[int, StaticTiles] = {block: {} for block in stored["blocks"].tolist()}
        for (block, row, column), tile in zip(stored["places"].tolist(), stored["bits"], strict=True):
            times[block][row, column] = tile
        return KindsOfTimes(times, grid)
    static = WorldCells(1, np.bool_)
    places, tiles = stored["places"].tolist(), stored["static"]
    static.tiles = {(row, column): tile[None] for (row, column), tile in zip(places, tiles, strict=True)}
    return KindsOfPlaces(static, grid)


@dataclass(frozen=True, slots=True)
class StretchRegions:
    """The regions of one stretch. It is a MotionFinder for any source of its frames.

    `kinds`: of its cells; `moves`: whether the window moves; `stamps_ns` (N,) int64; `reference_T_world` (N, 3)
    float64: x, y, theta. The returns in motion of frame n are the cells `moving[starts[n] : starts[n + 1]]`, row * M +
    column.

    The scans of frame n, if the window moves, are `scan_starts[n]` to `scan_starts[n + 1]`, without labels and truth.
    Scan s has `ranges[range_starts[s] : range_starts[s + 1]]`, and in `geometry` (S, 7) float64 the angle of its first
    beam, that between beams, its range limits, and its reference pose.
    """

    sha256: str
    grid: str
    kinds: StoredKinds
    moves: bool
    stamps_ns: NDArray[np.int64]
    starts: NDArray[np.int64]
    moving: NDArray[np.int32]
    reference_T_world: NDArray[np.float64]
    scan_starts: NDArray[np.int64]
    range_starts: NDArray[np.int64]
    ranges: NDArray[np.float32]
    geometry: NDArray[np.float64]

    @classmethod
    def read(cls, path: Path) -> StretchRegions:
        """Read a file of `store_regions`. Raises OSError."""
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        grid = str(arrays["grid"])
        of_frames = {one.name: arrays[one.name] for one in fields(cls)[4:]}
        kinds = _kinds_from(arrays, GridSpec.parse(grid))
        return cls(str(arrays["sha256"]), grid, kinds, bool(arrays["moves"]), **of_frames)

    def has(self, source: FrameSource, stamp_ns: int) -> bool:
        """Whether the frame of `source` with this stamp belongs to the stretch."""
        n = self._number(stamp_ns)
        same = source.sha256 == self.sha256 and str(source.grid) == self.grid
        return same and n < len(self.stamps_ns) and int(self.stamps_ns[n]) == stamp_ns

    def of(self, observation: Observation) -> InCells:
        """The returns in motion of an observation of the stretch."""
        n = self._number(observation.frame.stamp_ns)
        marked = np.zeros(observation.frame.occupied.shape, np.bool_)
        marked.reshape(-1)[self.moving[self.starts[n] : self.starts[n + 1]]] = True
        return InCells(marked, observation.reference_T_grid)

    def observation_of(self, frame: GridFrame) -> Observation:
        """The observation of a frame of the stretch, at its place in the world of the reference poses."""
        n = self._number(frame.stamp_ns)
        reference_T_world = SE2(*self.reference_T_world[n].tolist())
        scans = tuple(self._scan(s, frame.stamp_ns) for s in range(self.scan_starts[n], self.scan_starts[n + 1]))
        grid_T_reference = (reference_T_world @ frame.world_T_grid).inverse()
        grid_T_sensor = tuple(grid_T_reference @ scan.world_T_sensor for scan in scans)
        return Observation(frame, scans, grid_T_sensor, reference_T_world=reference_T_world)

    def _scan(self, s: int, stamp_ns: int) -> Scan:
        ranges = self.ranges[self.range_starts[s] : self.range_starts[s + 1]]
        angle_min, step, range_min, range_max, *pose = self.geometry[s].tolist()
        return Scan(stamp_ns, ranges, angle_min, step, range_min, range_max, world_T_sensor=SE2(*pose))

    def _number(self, stamp_ns: int) -> int:
        return int(np.searchsorted(self.stamps_ns, stamp_ns))


class InCells:
    """Returns in marked cells (M, M) of the window at `own`."""

    bodies = None

    def __init__(self, marked: Mask, own: SE2) -> None:
        self._marked, self._own = marked, own

    def among(self, observation: Observation, grid: GridSpec) -> Mask:
        """The returns in motion (M, M) of the observation."""
        window = observation.reference_T_grid
        marked: Mask = (
            self._marked if window == self._own else cells_in_window(self._marked[None], self._own, window, grid)[0]
        )
        return marked


class FitScores:
    """The `score` function of a training: it scores stretches that `fit` received, and parts of them."""

    def __init__(self, stretches: Sequence[FrameSource], regions_of: Callable[[int], Path]) -> None:
        """`regions_of(n)` is the file with the regions of `stretches[n]`, requested when that stretch is scored."""
        self._stretches, self._regions_of = tuple(stretches), regions_of
        self._read: dict[int, StretchRegions] = {}

    def score(self, tracker: Tracker, source: FrameSource, steps: int) -> StretchScore:
        """Stream `source` through the tracker and score its forecasts. Raises RecordingError."""
        first = next(iter(source))
        stretch = next((one for one in self._regions_beside(source) if one.has(source, first.stamp_ns)), None)
        if stretch is None:
            raise RecordingError(f"{source.name}: can't be scored: it is not part of a stretch that fit received")
        if stretch.moves and not tracker.moving_sensor:
            raise RecordingError(
                f"{source.name}: the sensor moves, and {type(tracker).__name__} follows only a sensor at rest"
                " (moving_sensor is false): train on stretches in which it is at rest"
            )
        return score_in_process(tracker, source, steps, Regions(source.grid, stretch.kinds), stretch)

    def _regions_beside(self, source: FrameSource) -> Iterator[StretchRegions]:
        """The regions of the stretches of the same recording, on the same grid."""
        for n, one in enumerate(self._stretches):
            if one.sha256 == source.sha256 and str(one.grid) == str(source.grid):
                if n not in self._read:
                    self._read[n] = StretchRegions.read(self._regions_of(n))
                yield self._read[n]


FIT_FORECAST_EVERY_S = 1.0
FIT_FORECASTS = 30
LEAST_FIT_EVERY = 5
"""A forecast a second, of a short stretch FIT_FORECASTS, but at most after every fifth frame. They are most of what a
validation of a network costs; twice as many changed a difference of two settings, on ten worlds, by less than 0.001."""


def score_in_process(
    tracker: Tracker, source: FrameSource, steps: int, regions: Regions, stretch: StretchRegions | None = None
) -> StretchScore:
    """Stream `source` through the tracker and score its forecasts with the referee's counts, on its regions.

    Observations and motion are those of the `stretch`; None: by the source itself. Thresholds are chosen on the same
    frames: a score for choosing parameters, not for reports. Raises RecordingError if these are too few for a forecast.
    """
    every = max(LEAST_FIT_EVERY, min(round(FIT_FORECAST_EVERY_S / source.period_s), len(source) // FIT_FORECASTS))
    schedule = Schedule(len(source), steps, every)
    if not schedule.expected:
        raise RecordingError(f"{source.name}: {len(source)} frames are too few to score forecasts of {steps} steps")
    facts = TrialFacts(source.grid.cell_m, steps, STRATA, half(steps), period_s=source.period_s)
    tally, memory = Tally.empty(steps), CONTACT_FORESIGHT.new_memory(facts)
    contacts: Any = 0.0
    observations = None if stretch is None else map(stretch.observation_of, source)
    for scored in scored_forecasts(tracker, moments(source, regions, observations, stretch), schedule, seed=0):
        tally.add(count_cells(scored.forecast.occupancy, scored.targets, scored.region_maps))
        contacts += CONTACT_FORESIGHT.count(scored, facts, memory)
    confusion = tally.confusion(best_thresholds(tally, source.name).bins)
    f1, log_loss = f1_of(confusion), divided(tally.log_loss, tally.cells.sum(axis=-1))
    return StretchScore(
        f1={name: f1[:, k] for k, name in enumerate(STRATA)},
        log_loss={name: log_loss[:, k] for k, name in enumerate(STRATA)},
        contacts_foreseen=CONTACT_FORESIGHT.leading(contacts, facts)[:, 0],
    )
