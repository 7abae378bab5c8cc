"""ROS messages as scans, transforms and poses: the common part of the ROS formats."""

from __future__ import annotations

import contextlib
import math
import struct
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.errors import RecordingError, did_you_mean
from gridtrack.common.scan import Scan
from gridtrack.recordings.file_reading import DamageError
from gridtrack.recordings.framed_recording import Content, EncodedMessage, FramedRecording
from gridtrack.recordings.frames.trajectory import FramedScan
from gridtrack.recordings.frames.transform import SE3
from gridtrack.recordings.frames.tree import StampedTransform
from gridtrack.recordings.native_messages import MAX_SWEEP_S
from gridtrack.recordings.output_definitions import ROS1_OUTPUTS, ROS2_OUTPUTS
from gridtrack.recordings.people import Annotation
from gridtrack.recordings.read_options import CloudSlice, ReadOptions
from gridtrack.recordings.recording import Topics
from gridtrack.recordings.ros_people import PeopleReader, is_people

LASER_SCAN = "sensor_msgs/msg/LaserScan"
MULTI_ECHO = "sensor_msgs/msg/MultiEchoLaserScan"
POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
POSES = (
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
)
HEIGHTS, EXAMPLE_SLICE = "heights in the frame of the sensor", "low_m=0.2,high_m=1.0"
FLAT_M = 0.2
"""Difference of the heights in a cloud below which it is flat: of a laser with one plane."""
ROS_OPTIONS = ("topic", "cloud_slice", "pose_topic", "mounts", "stamps")
FINE_BEAMS = 720
"""Bearings of a revolution, unless the clouds have fewer."""
SAME_BEARING_RAD = 1e-4
FEWEST_BEARINGS, ON_GRID, MOST_ON_GRID = 20, 0.1, 0.9
"""Number of bearings from which a cloud may have a grid of its own; the distance from it, as a share of its step, of a
bearing that lies on it; and the share of bearings that must."""
POINT_FIELD_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


def ros2_name(kind: str) -> str:
    """`package/Name` of ROS 1 as `package/msg/Name` of ROS 2; other names unchanged."""
    package, _, name = kind.partition("/")
    is_ros1 = bool(name) and not name.startswith(("msg/", "srv/", "action/"))
    return f"{package}/msg/{name}" if is_ros1 else kind


def stamp_ns(message: Any) -> int:
    """The stamp in the header of a message, nanoseconds."""
    return int(message.header.stamp.sec) * 1_000_000_000 + int(message.header.stamp.nanosec)


def frame_in_header(encoding: str, data: bytes) -> str:
    """The frame in the std_msgs/Header at the beginning of a message, without decoding all of it.

    ROS 1: sequence number, stamp, length, frame. CDR: encapsulation (byte 1: byte order), stamp, length, frame and 0.
    Raises struct.error, UnicodeDecodeError.
    """
    order = "<" if encoding == "ros1" or data[1] & 1 else ">"
    (size,) = struct.unpack_from(f"{order}I", data, 12)
    if len(data) < 16 + size:
        raise struct.error("the frame is cut off")
    return data[16 : 16 + size].rstrip(b"\x00").decode()


def transform_of(translation: Any, rotation: Any) -> SE3 | None:
    """A geometry_msgs/Transform or Pose from its two parts; None if its numbers are not a transform."""
    return SE3.of((translation.x, translation.y, translation.z), (rotation.x, rotation.y, rotation.z, rotation.w))


def scan_of_laser(message: Any, sensor: str, received_ns: int) -> Scan:
    """A sensor_msgs/LaserScan as a scan, stamped by its header, or else by its reception."""
    return Scan(
        stamp_ns=stamp_ns(message) or received_ns,
        ranges=np.array(message.ranges, np.float32),
        angle_min=float(message.angle_min),
        angle_increment=float(message.angle_increment),
        range_min=float(message.range_min),
        range_max=float(message.range_max),
        sensor=sensor,
        time_increment_s=_time_increment_s(message),
        last_angle=float(message.angle_max),
    )


def _time_increment_s(message: Any) -> float:
    """The time between beams; 0 (not known) for an impossible value."""
    increment_s = float(message.time_increment)
    return increment_s if 0.0 <= increment_s * max(len(message.ranges) - 1, 0) <= MAX_SWEEP_S else 0.0


class Bearings(NamedTuple):
    """The beams of a scan that is cut from clouds: their number in a revolution, and the first one from -pi on."""

    beams: int
    first_rad: float

    @property
    def step_rad(self) -> float:
        """The angle between two beams."""
        return 2.0 * math.pi / self.beams


def bearings_of(points: NDArray[np.float64], beams: int | None) -> Bearings:
    """The bearings of a scan made from points (N, 3): `beams` of them, or the bearings of the points.

    Points have bearings of their own if most of them lie on a regular grid that is coarser than FINE_BEAMS: a finer
    scan would have empty beams between them, which say that walls are free.
    """
    regular = Bearings(beams or FINE_BEAMS, -math.pi + math.pi / (beams or FINE_BEAMS))
    angles = np.sort(np.arctan2(points[:, 1], points[:, 0]))
    gaps = np.diff(angles)
    gaps = gaps[gaps > SAME_BEARING_RAD]
    if beams is not None or gaps.size < FEWEST_BEARINGS:
        return regular
    count = round(2.0 * math.pi / float(np.median(gaps)))
    step = 2.0 * math.pi / count
    phase = float(np.angle(np.mean(np.exp(1j * angles * count)))) / count
    off = np.abs((angles - phase + step / 2.0) % step - step / 2.0)
    if count >= FINE_BEAMS or np.mean(off < ON_GRID * step) < MOST_ON_GRID:
        return regular
    return Bearings(count, phase - step * math.floor((phase + math.pi) / step))


def scan_of_cloud(message: Any, sensor: str, received_ns: int, cut: CloudSlice, bearings: Bearings) -> Scan:
    """A height slice of a sensor_msgs/PointCloud2 as a scan: one revolution of `bearings`.

    A cloud without any point gives no information about free space, with any `empty`.
    """
    points = cloud_points(message)
    is_unknown = cut.empty == "unknown" or not len(points)
    points = in_slice(points, cut)
    distance = np.hypot(points[:, 0], points[:, 1])
    bearing = np.arctan2(points[:, 1], points[:, 0])
    beam = np.round((bearing - bearings.first_rad) / bearings.step_rad).astype(np.int64) % bearings.beams
    ranges = np.full(bearings.beams, np.inf)
    np.minimum.at(ranges, beam, distance)
    if is_unknown:
        ranges[np.isinf(ranges)] = np.nan
    return Scan(
        stamp_ns=stamp_ns(message) or received_ns,
        ranges=ranges.astype(np.float32),
        angle_min=bearings.first_rad,
        angle_increment=bearings.step_rad,
        range_min=cut.range_min_m,
        range_max=cut.range_max_m,
        sensor=sensor,
    )


def in_slice(points: NDArray[np.float64], cut: CloudSlice) -> NDArray[np.float64]:
    """The points (N, 3) between the heights and ranges of the slice."""
    distance = np.hypot(points[:, 0], points[:, 1])
    inside = (points[:, 2] >= cut.low_m) & (points[:, 2] <= cut.high_m)
    return points[inside & (distance >= cut.range_min_m) & (distance <= cut.range_max_m)]


def cloud_points(message: Any) -> NDArray[np.float64]:
    """x, y, z (N, 3) of a sensor_msgs/PointCloud2, metres, sensor frame, without points that are not finite.

    Raises RecordingError if the cloud lacks these fields, or has fewer bytes than its header declares.
    """
    rows, columns, step = message.height, message.width, message.point_step
    if not rows * columns:
        return np.empty((0, 3))  # an empty cloud may have neither fields nor a row_step
    fields = {f.name: f for f in message.fields}
    order = ">" if message.is_bigendian else "<"
    row_step = message.row_step or columns * step  # some drivers write 0
    data = np.asarray(message.data, np.uint8)
    if not {"x", "y", "z"} <= set(fields):
        raise RecordingError(f"a point cloud with the fields {', '.join(fields) or 'none'}; expected x, y and z")
    if row_step < columns * step or data.size < rows * row_step:
        raise RecordingError(f"a point cloud of {rows} x {columns} points in {data.size} bytes")
    axes = []
    for name in ("x", "y", "z"):
        kind = np.dtype(order + POINT_FIELD_TYPES.get(fields[name].datatype, "V1"))
        if kind.kind == "V" or fields[name].offset + kind.itemsize > step:
            raise RecordingError(f"a point cloud with an unreadable field '{name}'")
        view = np.ndarray((rows, columns), kind, data.tobytes(), fields[name].offset, (row_step, step))
        axes.append(view.astype(np.float64).reshape(-1))
    points = np.stack(axes, axis=1)
    return points[np.isfinite(points).all(axis=1)]


@cache
def _ros1_types(outputs: bool) -> Any:
    """The message definitions for ROS 1, the same for every recording: rosbags compiles each at its first message.

    The many definitions of `outputs` take a tenth of a second, so that other messages have a store without them.
    """
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    for kind in TRANSFORMS:  # the packages of transforms are not in this store
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", kind))
    return _with_outputs(store, ROS1_OUTPUTS) if outputs else store


@cache
def _ros2_types(outputs: bool) -> Any:
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.LATEST)
    return _with_outputs(store, ROS2_OUTPUTS) if outputs else store


def _with_outputs(store: Any, definitions: Mapping[str, str]) -> Any:
    from rosbags.typesys import get_types_from_msg

    for kind, text in definitions.items():
        store.register(get_types_from_msg(text, kind))
    return store


class RosRecording(FramedRecording):
    """A recording of ROS messages.

    Every LaserScan topic is a sensor; a PointCloud2 topic is read if the options name it, and give the slice to cut
    from it. Messages are decoded by the definitions in rosbags, never by code made from the definitions in the
    recording.
    """

    def __init__(self, path: Path, options: ReadOptions) -> None:
        """Raises RecordingError if rosbags is not installed."""
        super().__init__(path, options)
        if isinstance(options.stamps, float):
            raise RecordingError(
                f"{path}: --stamps {options.stamps:g}hz: messages have times of reception: use received"
            )
        try:
            import rosbags.typesys  # noqa: F401
            from rosbags.serde import SerdeError
        except ImportError:
            raise RecordingError("reading ROS recordings needs rosbags: pip install 'gridtrack[ros]'") from None
        self._bearings: Bearings | None = None
        self._errors = (SerdeError, struct.error, ValueError, IndexError, UnicodeDecodeError)

    @contextmanager
    def decoded(self, message: EncodedMessage) -> Iterator[Any]:
        """The decoded message. Raises DamageError if decoding it, or using it inside the block, fails."""
        try:
            if message.encoding == "ros1":
                yield _ros1_types(message.kind in ROS1_OUTPUTS).deserialize_ros1(message.data, message.kind)
            elif message.encoding == "cdr":
                yield _ros2_types(message.kind in ROS2_OUTPUTS).deserialize_cdr(message.data, message.kind)
            else:
                raise RecordingError(f"'{message.topic}' is encoded as '{message.encoding}'; expected ros1 or cdr")
        except self._errors as error:
            raise DamageError(f"corrupt: a message of {message.topic} cannot be decoded ({error})") from None

    def content_of(self, message: EncodedMessage) -> Content | None:
        """As in every recording with frames."""
        if message.kind in (LASER_SCAN, MULTI_ECHO, POINT_CLOUD):
            return "scan"
        if message.kind in TRANSFORMS:
            return "transforms"
        return "pose" if message.kind in POSES else None

    def is_read(self, message: EncodedMessage) -> bool:
        """Whether the scans of a topic are read: point clouds only if the options name the topic."""
        return super().is_read(message) and (message.kind != POINT_CLOUD or self.options.topic is not None)

    def frame_of(self, message: EncodedMessage) -> str:
        """As in every recording with frames."""
        try:
            return frame_in_header(message.encoding, message.data)
        except self._errors as error:
            raise DamageError(f"corrupt: a message of {message.topic} cannot be decoded ({error})") from None

    def transforms_of(self, message: EncodedMessage) -> Iterable[StampedTransform]:
        """As in every recording with frames."""
        with self.decoded(message) as decoded:
            if message.kind in TRANSFORMS:
                for t in decoded.transforms:
                    transform = transform_of(t.transform.translation, t.transform.rotation)
                    yield _stamped(message, t, t.child_frame_id, transform)
            else:
                pose = decoded.pose.pose if hasattr(decoded.pose, "pose") else decoded.pose
                transform = transform_of(pose.position, pose.orientation)
                yield _stamped(message, decoded, getattr(decoded, "child_frame_id", ""), transform)

    def scan_of(self, message: EncodedMessage) -> FramedScan:
        """As in every recording with frames."""
        sensor = self.sensor_of(message.topic)
        with self.decoded(message) as decoded:
            if not stamp_ns(decoded):
                self.warn(f"topic '{message.topic}': its headers have no stamps, the time of reception is used")
            frame = str(decoded.header.frame_id)
            if message.kind == MULTI_ECHO:
                self.notify(f"topic '{message.topic}': of several echoes of a beam the first is read, the nearest one")
                decoded.ranges = [echo.echoes[0] if len(echo.echoes) else np.inf for echo in decoded.ranges]
            if message.kind != POINT_CLOUD:
                return FramedScan(message.topic, frame, scan_of_laser(decoded, sensor, message.received_ns))
            if self.options.cloud_slice is None:
                raise RecordingError(
                    f"'{message.topic}' is a point cloud: give its slice, {HEIGHTS}, as in --cloud-slice"
                    f" {EXAMPLE_SLICE}"
                )
            bearings = self._bearings_of(decoded, self.options.cloud_slice)
            scan = scan_of_cloud(decoded, sensor, message.received_ns, self.options.cloud_slice, bearings)
            return FramedScan(message.topic, frame, scan)

    def _bearings_of(self, cloud: Any, cut: CloudSlice) -> Bearings:
        """The bearings of all scans from clouds: from the first cloud with enough points in the slice."""
        if self._bearings is None:
            points = in_slice(cloud_points(cloud), cut)
            bearings = bearings_of(points, cut.beams)
            if cut.beams is None and len(points) < FEWEST_BEARINGS:
                return bearings
            self._bearings = bearings
            if bearings.beams < FINE_BEAMS and cut.beams is None:
                self.notify(f"its clouds have {bearings.beams} bearings in a revolution, and so have the scans of them")
        return self._bearings

    def _example_slice(self, topic: str) -> str:
        """The option for a slice of the clouds on a topic: all of a flat cloud, else usual heights."""
        with contextlib.suppress(DamageError, RecordingError, StopIteration):
            with self.decoded(next(one for one in self.messages() if one.topic == topic)) as cloud:
                heights_m = cloud_points(cloud)[:, 2]
            if heights_m.size and np.ptp(heights_m) < FLAT_M:
                return f"low_m={heights_m.min() - FLAT_M / 2:.1f},high_m={heights_m.max() + FLAT_M / 2:.1f}"
        return EXAMPLE_SLICE

    def annotations(self, topic: str, *, by_order: bool) -> Iterator[Annotation]:
        """As in every recording: from messages of people, or of poses."""
        known: dict[str, None] = {}
        reader = PeopleReader(topic, by_order=by_order, received=self.options.stamps == "received")
        for message in self._messages_before_damage():
            if not is_people(message.kind):
                continue
            known[message.topic] = None
            if message.topic == topic:
                try:
                    with self.decoded(message) as decoded:
                        yield from reader.read(decoded, message.kind, message.received_ns)
                except (DamageError, RecordingError) as error:
                    raise RecordingError(f"{self.path}: {error}") from None
        if topic not in known:
            raise RecordingError(f"{self.path}: no topic '{topic}' with people; {did_you_mean(topic, known)}")

    def _messages_before_damage(self) -> Iterator[EncodedMessage]:
        with contextlib.suppress(DamageError):  # reported when the scans are read
            yield from self.messages()

    def why_no_scans(self, topics: Topics) -> str:
        """As in every recording; point clouds are read on request."""
        clouds = [topic for topic, kind in topics.types.items() if kind == POINT_CLOUD]
        if self.options.topic is not None or not clouds:
            return super().why_no_scans(topics)
        command = self.import_command(["--topic", clouds[0], "--cloud-slice", self._example_slice(clouds[0])])
        return f"no laser scans: take them from a slice of the point cloud, {HEIGHTS}, with `{command}`"


def _stamped(message: EncodedMessage, decoded: Any, child: str, transform: SE3 | None) -> StampedTransform:
    """A transform with the stamp of its header, or else of its reception."""
    return StampedTransform(stamp_ns(decoded) or message.received_ns, decoded.header.frame_id, child, transform)
