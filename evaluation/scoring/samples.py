"""Samples of a trial's forecasts: an MCAP file of grids that opens in Foxglove, and that reports read.

The log time of a sample is the stamp of frame t: `/input` is x_t, `/sensors` the positions of the sensors in it,
`/objects` the tracker's objects at t, `/came/1s` the frame observed one second later, `/scored/1s` what was known of
every cell then, and `/forecast/1s` the forecast of it. Probabilities have 255 steps.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.message import DecodeError
from mcap.exceptions import McapError
from mcap.records import Channel, Chunk, Message
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap_protobuf.writer import Writer
from numpy.typing import NDArray
from zstandard import ZstdError

from gridtrack.common.errors import GridtrackError
from gridtrack.common.files import atomic_write
from gridtrack.common.grid import GridSpec, Mask
from gridtrack.evaluation.scoring.referee import Schedule, ScoredForecast
from gridtrack.evaluation.scoring.sample_objects import KeptObject, objects_message, objects_of
from gridtrack.evaluation.scoring.strata import PARTS
from gridtrack.evaluation.scoring.target import NOT_SCORED, Target

SAMPLES = "forecasts.mcap"
KEPT = 40
"""Samples of a trial: the same scored frames for every tracker, evenly spaced."""
HORIZONS_S = (0.5, 1.0, 2.0)
MAX_CHUNK_BYTES = 1 << 26
MAX_TOPICS = 64
SENSORS, TRACKED_OBJECTS = "/sensors", "/objects"
OCCUPANCY_FIELDS = ("visible", "occupied")
SCORED_FIELDS = ("state", "in_motion")
PROBABILITY_FIELDS = ("probability",)


_MESSAGES: dict[str, Any] = {SENSORS: PosesInFrame, TRACKED_OBJECTS: SceneUpdate}
"""The schemas of the topics that are not grids."""
_UNREADABLE = (OSError, McapError, DecodeError, ZstdError, struct.error, GridtrackError, ValueError, KeyError)


class SamplesError(GridtrackError):
    """A file of samples that cannot be read."""


@dataclass(frozen=True, slots=True)
class Sample:
    """One forecast, and the frames that it is a forecast of.

    `visible`, `occupied` (M, M) bool: x_t; `origins` (S, 2) float32: positions of the sensors, metres, grid frame; per
    horizon H: `forecast` (H, M, M) float32 in [0, 1], and `observed_visible`, `observed_occupied` (H, M, M) bool, the
    frame observed at that horizon.
    """

    stamp_ns: int
    horizons_s: tuple[float, ...]
    grid: GridSpec
    visible: Mask
    occupied: Mask
    origins: NDArray[np.float32]
    forecast: NDArray[np.float32]
    observed_visible: Mask
    observed_occupied: Mask
    state: NDArray[np.uint8]
    """(H, M, M): the states of `target.py`. Of a file without them, which earlier runs wrote, of the visible cells
    alone."""
    in_motion: Mask | None = None
    """(H, M, M): the visible cells of the stratum `in-motion`; None of a file without them."""
    objects: tuple[KeptObject, ...] = ()


def kept_forecasts(schedule: Schedule) -> frozenset[int]:
    """Indices of the scored frames (0 .. expected-1) that become samples."""
    expected = schedule.expected
    return frozenset(np.linspace(0, expected - 1, min(KEPT, expected)).round().astype(int).tolist())


class SampleWriter:
    """Writes samples; on closing the file is complete, however the trial ended."""

    def __init__(self, path: Path, grid: GridSpec, period_s: float, steps: int) -> None:
        self._grid = grid
        steps_of = {h: round(h / period_s) for h in HORIZONS_S}
        self._steps = {h: step for h, step in steps_of.items() if 1 <= step <= steps}
        self._file = ExitStack()
        self._writer = Writer(self._file.enter_context(atomic_write(path)))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._file:
            self._writer.finish()  # type: ignore[no-untyped-call]

    def add(self, scored: ScoredForecast) -> None:
        """Write one forecast, with the frames that it is a forecast of."""
        stamp_ns, frames = scored.stamp_ns, scored.frames
        self._write("/input", stamp_ns, _planes(frames[0].visible, frames[0].occupied), OCCUPANCY_FIELDS)
        self._write_message(SENSORS, stamp_ns, _sensor_poses(frames[0].origins, stamp_ns))
        self._write_message(TRACKED_OBJECTS, stamp_ns, objects_message(scored.forecast.objects, stamp_ns))
        for horizon, step in self._steps.items():
            observed = frames[step]
            self._write(f"/came/{horizon:g}s", stamp_ns, _planes(observed.visible, observed.occupied), OCCUPANCY_FIELDS)
            known = _scored_planes(scored.targets[step], scored.region_maps.dynamic)
            self._write(f"/scored/{horizon:g}s", stamp_ns, known, SCORED_FIELDS)
            probability = (scored.forecast.occupancy[step] * 255).round().astype(np.uint8)
            self._write(f"/forecast/{horizon:g}s", stamp_ns, probability[..., None], PROBABILITY_FIELDS)

    def _write(self, topic: str, stamp_ns: int, planes: NDArray[np.uint8], fields: tuple[str, ...]) -> None:
        self._write_message(topic, stamp_ns, _message(self._grid, stamp_ns, planes, fields))

    def _write_message(self, topic: str, stamp_ns: int, message: Any) -> None:
        self._writer.write_message(topic, message, log_time=stamp_ns, publish_time=stamp_ns)


def _sensor_poses(origins: NDArray[np.float32], stamp_ns: int) -> Any:
    """Message with the sensors at `origins` (S, 2), metres, grid frame."""
    message = PosesInFrame(frame_id="grid")
    message.timestamp.FromNanoseconds(stamp_ns)
    for x, y in origins.tolist():
        pose = message.poses.add()
        pose.position.x, pose.position.y, pose.orientation.w = x, y, 1.0
    return message


def _planes(visible: Mask, occupied: Mask) -> NDArray[np.uint8]:
    """Two planes (M, M, 2) uint8, 255 where the cell is visible, and where it is occupied."""
    return np.stack([visible, occupied], axis=-1).astype(np.uint8) * np.uint8(255)


def _scored_planes(target: Target, dynamic: Mask) -> NDArray[np.uint8]:
    """Two planes (M, M, 2) uint8: the state of each cell, and 255 where it is visible and of the stratum in-motion."""
    in_motion = target.frame.visible & dynamic & (target.motion != PARTS.index("standing"))
    return np.stack([target.state, np.where(in_motion, np.uint8(255), np.uint8(0))], axis=-1)


def _message(grid: GridSpec, stamp_ns: int, planes: NDArray[np.uint8], fields: tuple[str, ...]) -> Any:
    message = Grid(frame_id="grid", column_count=grid.size, data=planes.tobytes())
    message.timestamp.FromNanoseconds(stamp_ns)
    message.pose.position.x, message.pose.position.y = grid.origin
    message.pose.orientation.w = 1.0
    message.cell_size.x = message.cell_size.y = grid.cell_m
    message.cell_stride = len(fields)
    message.row_stride = len(fields) * grid.size
    for offset, name in enumerate(fields):
        message.fields.append(PackedElementField(name=name, offset=offset, type=PackedElementField.UINT8))
    return message


def read_samples(path: Path) -> Iterator[Sample]:
    """The samples of a trial in the order of their stamps, one at a time in memory.

    Raises SamplesError where the file is damaged or not of this form, after the samples before the damage.
    """
    stamp_ns: int | None = None
    topics: dict[str, Any] = {}
    try:
        for topic, message in _messages(path):
            if stamp_ns is not None and message.log_time != stamp_ns:
                yield _sample(stamp_ns, topics)
                topics = {}
            stamp_ns = message.log_time
            if len(topics) == MAX_TOPICS:
                raise ValueError(f"more than {MAX_TOPICS} messages at {stamp_ns} ns")
            topics[topic] = _MESSAGES.get(topic, Grid).FromString(message.data)
        if stamp_ns is not None:
            yield _sample(stamp_ns, topics)
    except _UNREADABLE as error:
        raise SamplesError(f"{path}: cannot be read as samples ({error or type(error).__name__})") from None


def _messages(path: Path) -> Iterator[tuple[str, Message]]:
    """Topic and message, in file order; a chunk larger than MAX_CHUNK_BYTES is not unpacked."""
    topics: dict[int, str] = {}
    with path.open("rb") as file:
        for chunk in StreamReader(file, emit_chunks=True, record_size_limit=MAX_CHUNK_BYTES).records:
            if not isinstance(chunk, Chunk):
                continue
            if chunk.uncompressed_size > MAX_CHUNK_BYTES:
                raise ValueError(f"a chunk of {chunk.uncompressed_size} bytes; more than {MAX_CHUNK_BYTES} are refused")
            for record in breakup_chunk(chunk, validate_crc=True):
                if isinstance(record, Channel):
                    topics[record.id] = record.topic
                elif isinstance(record, Message):
                    yield topics[record.channel_id], record


def _sample(stamp_ns: int, topics: dict[str, Any]) -> Sample:
    """One sample from its messages by topic. Raises KeyError or ValueError where they do not fit together."""
    size = topics["/input"].column_count
    cell_m, corner = topics["/input"].cell_size.x, topics["/input"].pose.position
    grid = GridSpec(size, cell_m, (corner.x, corner.y))
    horizons = tuple(sorted(_seconds(topic) for topic in topics if topic.startswith("/forecast/")))
    occupancy = [_decoded(topics["/input"], grid, OCCUPANCY_FIELDS) == 255]
    occupancy += [_decoded(topics[f"/came/{h:g}s"], grid, OCCUPANCY_FIELDS) == 255 for h in horizons]
    forecast = np.zeros((len(horizons), *grid.shape), np.float32)
    for i, h in enumerate(horizons):
        forecast[i] = _decoded(topics[f"/forecast/{h:g}s"], grid, PROBABILITY_FIELDS)[..., 0] / np.float32(255)
    observed = np.array(occupancy[1:], bool).reshape(len(horizons), *grid.shape, 2)
    origins = np.array([(p.position.x, p.position.y) for p in topics[SENSORS].poses], np.float32).reshape(-1, 2)
    visible, occupied = np.moveaxis(occupancy[0], -1, 0)
    state, in_motion = _scored(topics, grid, horizons)
    if state is None:
        state = np.where(observed[..., 0], observed[..., 1], np.uint8(NOT_SCORED)).astype(np.uint8)
    objects = objects_of(topics[TRACKED_OBJECTS]) if TRACKED_OBJECTS in topics else ()
    seen, came = observed[..., 0], observed[..., 1]
    return Sample(stamp_ns, horizons, grid, visible, occupied, origins, forecast, seen, came, state, in_motion, objects)


def _scored(
    topics: dict[str, Any], grid: GridSpec, horizons: tuple[float, ...]
) -> tuple[NDArray[np.uint8] | None, Mask | None]:
    """The states (H, M, M) and the cells in motion (H, M, M); None where the file has none."""
    if not all(f"/scored/{h:g}s" in topics for h in horizons):
        return None, None
    planes = [_decoded(topics[f"/scored/{h:g}s"], grid, SCORED_FIELDS) for h in horizons]
    scored = np.array(planes, np.uint8).reshape(len(horizons), *grid.shape, 2)
    if scored[..., 0].max(initial=0) > NOT_SCORED:
        raise ValueError(f"a cell of state {scored[..., 0].max()}; states are 0 to {NOT_SCORED}")
    return scored[..., 0], scored[..., 1] == 255


def _seconds(topic: str) -> float:
    """The horizon in a topic's name: `/forecast/0.5s` is 0.5."""
    seconds = float(topic.rpartition("/")[2].removesuffix("s"))
    if not math.isfinite(seconds):
        raise ValueError(f"topic '{topic}' names no horizon")
    return seconds


def _decoded(message: Any, grid: GridSpec, fields: tuple[str, ...]) -> NDArray[np.uint8]:
    """A grid's fields as (M, M, F) uint8, its layout checked before it is used."""
    layout = (message.column_count, message.cell_stride, message.row_stride, len(message.data))
    expected = (grid.size, len(fields), len(fields) * grid.size, len(fields) * grid.size**2)
    if layout != expected or tuple(field.name for field in message.fields) != fields:
        raise ValueError(f"a grid of layout {layout}, expected {expected} with fields {fields}")
    return np.frombuffer(message.data, np.uint8).reshape(grid.size, grid.size, len(fields))
