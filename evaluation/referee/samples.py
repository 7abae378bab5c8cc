"""Samples of a trial's forecasts: an MCAP file of grids that opens in Foxglove, and that reports read.

The log time of a sample is the stamp of frame t: `/window` is the pose of its window in the world, `/input` x_t,
`/sensors` the positions of the sensors in it, `/tracks` the tracker's objects at t, `/came/1s` the frame observed one
second later, `/scored/1s` the known state of every cell then, and `/forecast/1s` the forecast of it, and `/robots` the
paths of virtual robots. Probabilities have 255 steps.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.message import DecodeError
from mcap_protobuf.writer import Writer
from numpy.typing import NDArray

from gridtrack.common.errors import GridtrackError
from gridtrack.common.files import atomic_write
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec, Mask, nearest_step
from gridtrack.evaluation.referee.referee import Schedule, ScoredForecast
from gridtrack.evaluation.referee.strata import PARTS
from gridtrack.evaluation.referee.targets import NOT_SCORED, Target
from gridtrack.recordings.file_reading import ReadBudget
from gridtrack.recordings.mcap_file import MCAP_MAGIC, McapFile
from gridtrack.recordings.native_messages import WORLD
from gridtrack.trackers.contract import TrackedObject

SAMPLES = "forecasts.mcap"
KEPT = 40
"""Samples of a trial: the same scored frames for every tracker, evenly spaced."""
HORIZONS_S = (0.5, 1.0, 2.0)
MAX_TOPICS = 64
BUDGET = ReadBudget(bytes_per_byte=2000, free_records=2 * KEPT * MAX_TOPICS)
"""Limits of an unpacked file of samples: most cells of a large grid are never seen, and compress well."""
SENSORS_TOPIC, TRACKS_TOPIC, WINDOW_TOPIC, ROBOTS_TOPIC = "/sensors", "/tracks", "/window", "/robots"

_MESSAGES: dict[str, Any] = {
    SENSORS_TOPIC: PosesInFrame,
    TRACKS_TOPIC: SceneUpdate,
    WINDOW_TOPIC: FrameTransform,
    ROBOTS_TOPIC: PointCloud,
}
"""The schemas of the topics that are not grids."""
_UNREADABLE = (OSError, DecodeError, GridtrackError, ValueError, KeyError)


class SamplesError(GridtrackError):
    """A file of samples that cannot be read."""


@dataclass(frozen=True, slots=True)
class RobotPaths:
    """Straight paths of N virtual robots from the input on, of those with a known outcome within the horizon.

    `places`, `velocities` (N, 2) float32: metres and m/s, grid frame. (N,) float32: `until_s`, seconds to the contact
    or the horizon of the paths; `contact`, 1 with a contact and 0 of a clear path; `risks`, the largest probability on
    the path, NaN if it is not known.
    """

    places: NDArray[np.float32]
    velocities: NDArray[np.float32]
    until_s: NDArray[np.float32]
    contact: NDArray[np.float32]
    risks: NDArray[np.float32]


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
    reference_T_grid: SE2 = field(default_factory=SE2)
    """The pose of the window in the world of ground truth; SE2() of a file without it, which earlier runs wrote."""
    robots: RobotPaths | None = None
    """None if there are too few paths, and of a file without them, which earlier runs wrote."""


def kept_forecasts(schedule: Schedule) -> frozenset[int]:
    """Indices of the scored frames (0 .. expected-1) that become samples."""
    expected = schedule.expected
    return frozenset(np.linspace(0, expected - 1, min(KEPT, expected)).round().astype(int).tolist())


class SampleWriter:
    """Writes samples; on closing the file is complete, however the trial ended."""

    def __init__(self, path: Path, grid: GridSpec, period_s: float, steps: int) -> None:
        self._grid = grid
        steps_of = {h: nearest_step(h, period_s) for h in HORIZONS_S}
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

    def add(self, scored: ScoredForecast, robots: RobotPaths | None = None) -> None:
        """Write one forecast, with the frames that it is a forecast of, and the paths of robots in them."""
        stamp_ns, frames = scored.stamp_ns, scored.frames
        self._write_message(WINDOW_TOPIC, stamp_ns, _window_message(scored.reference_T_grid, stamp_ns))
        self._write_occupancy("/input", stamp_ns, frames[0])
        self._write_message(SENSORS_TOPIC, stamp_ns, _sensor_poses(frames[0].origins, stamp_ns))
        self._write_message(TRACKS_TOPIC, stamp_ns, objects_message(scored.forecast.objects, stamp_ns))
        if robots is not None:
            self._write_message(ROBOTS_TOPIC, stamp_ns, _robots_message(robots, stamp_ns))
        for horizon, step in self._steps.items():
            self._write_occupancy(f"/came/{horizon:g}s", stamp_ns, frames[step])
            known = scored_planes(scored.targets[step], scored.region_maps.dynamic)
            self._write(f"/scored/{horizon:g}s", stamp_ns, known, (*SCORED_FIELDS, SHADE))
            forecast = probability_plane(np.nan_to_num(scored.forecast.occupancy[step], nan=0.5))
            self._write(f"/forecast/{horizon:g}s", stamp_ns, forecast, PROBABILITY_FIELDS)

    def _write_occupancy(self, topic: str, stamp_ns: int, frame: GridFrame) -> None:
        self._write(topic, stamp_ns, occupancy_planes(frame.visible, frame.occupied), (*OCCUPANCY_FIELDS, SHADE))

    def _write(self, topic: str, stamp_ns: int, planes: NDArray[np.uint8], fields: tuple[str, ...]) -> None:
        self._write_message(topic, stamp_ns, grid_message(self._grid, stamp_ns, planes, fields))

    def _write_message(self, topic: str, stamp_ns: int, message: Any) -> None:
        self._writer.write_message(topic, message, log_time=stamp_ns, publish_time=stamp_ns)


def _window_message(reference_T_grid: SE2, stamp_ns: int) -> Any:
    """Message with the pose of the window in the world."""
    message = FrameTransform(parent_frame_id=WORLD, child_frame_id=GRID_FRAME)
    message.timestamp.FromNanoseconds(stamp_ns)
    message.translation.x, message.translation.y = reference_T_grid.x, reference_T_grid.y
    half = reference_T_grid.theta / 2
    message.rotation.z, message.rotation.w = math.sin(half), math.cos(half)
    return message


ROBOT_FIELDS = ("x", "y", "vx", "vy", "until_s", "contact", "risk")


def _robots_message(robots: RobotPaths, stamp_ns: int) -> Any:
    """Message with a point for each path, at its start."""
    message = PointCloud(frame_id=GRID_FRAME, point_stride=4 * len(ROBOT_FIELDS))
    message.timestamp.FromNanoseconds(stamp_ns)
    message.pose.orientation.w = 1.0
    for number, name in enumerate(ROBOT_FIELDS):
        message.fields.add(name=name, offset=4 * number, type=PackedElementField.FLOAT32)
    columns = (robots.places, robots.velocities, robots.until_s, robots.contact, robots.risks)
    message.data = np.column_stack(columns).astype("<f4").tobytes()
    return message


def _robots_of(message: Any) -> RobotPaths:
    """The paths of a message. Raises ValueError if it has another form."""
    if tuple(field.name for field in message.fields) != ROBOT_FIELDS or message.point_stride != 4 * len(ROBOT_FIELDS):
        raise ValueError(f"robots with other fields than {', '.join(ROBOT_FIELDS)}")
    values = np.frombuffer(message.data, "<f4").reshape(-1, len(ROBOT_FIELDS))
    if not np.isfinite(values[:, :-1]).all():
        raise ValueError("robots with a place, a velocity or a time that is not finite")
    return RobotPaths(values[:, :2], values[:, 2:4], values[:, 4], values[:, 5], values[:, 6])


def _sensor_poses(origins: NDArray[np.float32], stamp_ns: int) -> Any:
    """Message with the sensors at `origins` (S, 2), metres, grid frame."""
    message = PosesInFrame(frame_id=GRID_FRAME)
    message.timestamp.FromNanoseconds(stamp_ns)
    for x, y in origins.tolist():
        pose = message.poses.add()
        pose.position.x, pose.position.y, pose.orientation.w = x, y, 1.0
    return message


def read_samples(path: Path) -> Iterator[Sample]:
    """The samples of a trial in the order of their stamps, one at a time in memory.

    Raises SamplesError if the file is damaged or not of this form, after the samples before the damage.
    """
    stamp_ns: int | None = None
    topics: dict[str, Any] = {}
    try:
        for topic, log_time_ns, data in _messages(path):
            if stamp_ns is not None and log_time_ns != stamp_ns:
                yield _sample(stamp_ns, topics)
                topics = {}
            stamp_ns = log_time_ns
            if len(topics) == MAX_TOPICS:
                raise ValueError(f"more than {MAX_TOPICS} messages at {stamp_ns} ns")
            topics[topic] = _MESSAGES.get(topic, Grid).FromString(data)
        if stamp_ns is not None:
            yield _sample(stamp_ns, topics)
    except _UNREADABLE as error:
        raise SamplesError(f"{path}: cannot be read as samples ({error or type(error).__name__})") from None


def _messages(path: Path) -> Iterator[tuple[str, int, bytes]]:
    """Topic, log time and content of the messages, in file order. Raises ValueError for a file that is cut off."""
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - len(MCAP_MAGIC)))
        if file.read() != MCAP_MAGIC:
            raise ValueError("cut off: the end of the file is missing")
    for message in McapFile(path, budget=BUDGET).messages():
        yield message.channel.topic, message.log_time_ns, message.data


def _sample(stamp_ns: int, topics: dict[str, Any]) -> Sample:
    """One sample from its messages by topic. Raises KeyError or ValueError where they do not fit together."""
    size = topics["/input"].column_count
    cell_m, corner = topics["/input"].cell_size.x, topics["/input"].pose.position
    grid = GridSpec(size, cell_m, (corner.x, corner.y))
    horizons = tuple(sorted(_seconds(topic) for topic in topics if topic.startswith("/forecast/")))
    occupancy = [planes_in(topics["/input"], grid, OCCUPANCY_FIELDS) == 255]
    occupancy += [planes_in(topics[f"/came/{h:g}s"], grid, OCCUPANCY_FIELDS) == 255 for h in horizons]
    forecast = np.zeros((len(horizons), *grid.shape), np.float32)
    for i, h in enumerate(horizons):
        forecast[i] = planes_in(topics[f"/forecast/{h:g}s"], grid, PROBABILITY_FIELDS)[..., 0] / np.float32(255)
    observed = np.array(occupancy[1:], bool).reshape(len(horizons), *grid.shape, 2)
    origins = np.array([(p.position.x, p.position.y) for p in topics[SENSORS_TOPIC].poses], np.float32).reshape(-1, 2)
    visible, occupied = np.moveaxis(occupancy[0], -1, 0)
    state, in_motion = _scored(topics, grid, horizons)
    if state is None:
        state = np.where(observed[..., 0], observed[..., 1], np.uint8(NOT_SCORED)).astype(np.uint8)
    objects = objects_of(topics[TRACKS_TOPIC]) if TRACKS_TOPIC in topics else ()
    seen, came = observed[..., 0], observed[..., 1]
    window = _window_of(topics[WINDOW_TOPIC]) if WINDOW_TOPIC in topics else SE2()
    robots = _robots_of(topics[ROBOTS_TOPIC]) if ROBOTS_TOPIC in topics else None
    return Sample(
        stamp_ns,
        horizons,
        grid,
        visible,
        occupied,
        origins,
        forecast,
        seen,
        came,
        state,
        in_motion,
        objects,
        window,
        robots,
    )


def _window_of(message: Any) -> SE2:
    """The pose of the window. Raises ValueError if it is not finite."""
    at, turned = message.translation, message.rotation
    pose = SE2(at.x, at.y, 2 * math.atan2(turned.z, turned.w))
    if not math.isfinite(pose.x + pose.y + pose.theta):
        raise ValueError(f"a window at {pose.x:g}, {pose.y:g}; expected a finite pose")
    return pose


def _scored(
    topics: dict[str, Any], grid: GridSpec, horizons: tuple[float, ...]
) -> tuple[NDArray[np.uint8] | None, Mask | None]:
    """The states (H, M, M) and the cells in motion (H, M, M); None if the file has none."""
    if not all(f"/scored/{h:g}s" in topics for h in horizons):
        return None, None
    planes = [planes_in(topics[f"/scored/{h:g}s"], grid, SCORED_FIELDS) for h in horizons]
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


GRID_FRAME = "grid"
"""The coordinate frame of every message of a sample: the window of frame t."""
OCCUPANCY_FIELDS = ("visible", "occupied")
SCORED_FIELDS = ("state", "in_motion")
PROBABILITY_FIELDS = ("probability",)
SHADE = "shade"
"""The field that a viewer colours by, the last one: 0 if nothing is known, small where free, 255 where occupied."""
FREE_SHADE = 64
_SHADE_OF_STATE = np.array([FREE_SHADE, 255, FREE_SHADE // 2, 191, 0], np.uint8)
"""Seen free, seen occupied, hidden and free, hidden and occupied, not scored: the states of `target.py`."""


def occupancy_planes(visible: Mask, occupied: Mask) -> NDArray[np.uint8]:
    """Three planes (M, M, 3) uint8: 255 where the cell is visible, 255 where it is occupied, and the shade."""
    shade = np.where(occupied, np.uint8(255), np.where(visible, np.uint8(FREE_SHADE), np.uint8(0)))
    return np.stack([visible * np.uint8(255), occupied * np.uint8(255), shade], axis=-1)


def scored_planes(target: Target, dynamic: Mask) -> NDArray[np.uint8]:
    """Three planes (M, M, 3) uint8: the state, 255 in the visible cells of the stratum in-motion, and the shade."""
    in_motion = target.frame.visible & dynamic & (target.motion != PARTS.index("standing"))
    return np.stack([target.state, in_motion * np.uint8(255), _SHADE_OF_STATE[target.state]], axis=-1)


def probability_plane(probability: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Probabilities (M, M) in [0, 1] as one plane (M, M, 1) uint8 of 255 steps."""
    return (probability * 255).round().astype(np.uint8)[..., None]


def grid_message(grid: GridSpec, stamp_ns: int, planes: NDArray[np.uint8], fields: tuple[str, ...]) -> Any:
    """A message with `planes` (M, M, F) as its `fields`: columns along x, rows along y, from the lower-left corner."""
    message = Grid(frame_id=GRID_FRAME, column_count=grid.size, data=planes.tobytes())
    message.timestamp.FromNanoseconds(stamp_ns)
    message.pose.position.x, message.pose.position.y = grid.origin
    message.pose.orientation.w = 1.0
    message.cell_size.x = message.cell_size.y = grid.cell_m
    message.cell_stride = len(fields)
    message.row_stride = len(fields) * grid.size
    for offset, name in enumerate(fields):
        message.fields.append(PackedElementField(name=name, offset=offset, type=PackedElementField.UINT8))
    return message


def planes_in(message: Any, grid: GridSpec, fields: tuple[str, ...]) -> NDArray[np.uint8]:
    """The `fields` of a message as (M, M, F) uint8, its layout checked before it is used; others after them are left.

    Raises ValueError.
    """
    stored = tuple(field.name for field in message.fields)
    count = len(stored)
    layout = (message.column_count, message.cell_stride, message.row_stride, len(message.data))
    expected = (grid.size, count, count * grid.size, count * grid.size**2)
    if layout != expected or stored[: len(fields)] != fields:
        raise ValueError(f"a grid of layout {layout}, expected {expected} with fields {fields}")
    return np.frombuffer(message.data, np.uint8).reshape(grid.size, grid.size, count)[..., : len(fields)]


HEIGHT_M = 1.0
"""Height of the cubes in a viewer: a grid says nothing of it."""
HEAD_SHARE, HEAD_M = 0.3, 0.4
"""Length of an arrow's head: this share of the arrow, and at most this."""
_RGBA = (0.1, 0.45, 0.9, 0.5)


@dataclass(frozen=True, slots=True)
class KeptObject:
    """One object of a forecast at step 0, in the grid frame.

    `box`: x, y, heading, length along it, width (metres, radians); `velocity`: m/s.
    """

    track: int
    box: tuple[float, float, float, float, float]
    velocity: tuple[float, float]


def objects_message(objects: Sequence[TrackedObject], stamp_ns: int) -> Any:
    """The objects as a message, which replaces all objects of the message before."""
    message = SceneUpdate()
    message.deletions.add(type=SceneEntityDeletion.ALL).timestamp.FromNanoseconds(stamp_ns)
    for one in objects:
        x, y, heading, length, width = one.box.tolist()
        entity = message.entities.add(id=str(one.track), frame_id=GRID_FRAME)
        entity.timestamp.FromNanoseconds(stamp_ns)
        cube = entity.cubes.add()
        _place(cube.pose, x, y, heading)
        cube.pose.position.z = HEIGHT_M / 2
        cube.size.x, cube.size.y, cube.size.z = length, width, HEIGHT_M
        vx, vy = one.velocity.tolist()
        speed = math.hypot(vx, vy)
        head_m = min(HEAD_SHARE * speed, HEAD_M)
        arrow = entity.arrows.add(
            shaft_length=speed - head_m, shaft_diameter=0.1, head_length=head_m, head_diameter=0.3
        )
        _place(arrow.pose, x, y, math.atan2(vy, vx))
        for colour in (cube.color, arrow.color):
            colour.r, colour.g, colour.b, colour.a = _RGBA
    return message


def objects_of(message: Any) -> tuple[KeptObject, ...]:
    """The objects of a message of `objects_message`. Raises ValueError if one has another form."""
    objects = []
    for entity in message.entities:
        if len(entity.cubes) != 1 or len(entity.arrows) != 1:
            raise ValueError(f"object {entity.id!r} is not one cube with one arrow")
        (cube,), (arrow,) = entity.cubes, entity.arrows
        place, towards = cube.pose.position, _heading(arrow.pose)
        box = (place.x, place.y, _heading(cube.pose), cube.size.x, cube.size.y)
        speed = arrow.shaft_length + arrow.head_length
        velocity = (speed * math.cos(towards), speed * math.sin(towards))
        if not all(map(math.isfinite, (*box, *velocity))):
            raise ValueError(f"object {entity.id!r} is not of finite numbers")
        objects.append(KeptObject(int(entity.id), box, velocity))
    return tuple(objects)


def _place(pose: Any, x: float, y: float, heading: float) -> None:
    pose.position.x, pose.position.y = x, y
    pose.orientation.z, pose.orientation.w = math.sin(heading / 2), math.cos(heading / 2)


def _heading(pose: Any) -> float:
    return 2 * math.atan2(pose.orientation.z, pose.orientation.w)
