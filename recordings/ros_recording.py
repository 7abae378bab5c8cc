"""ROS messages as scans, transforms and poses: the common part of the ROS formats."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.errors import RecordingError
from gridtrack.common.scan import Scan
from gridtrack.recordings.framed_recording import Content, EncodedMessage, FramedRecording
from gridtrack.recordings.frames.trajectory import FramedScan
from gridtrack.recordings.frames.transform import SE3
from gridtrack.recordings.frames.tree import StampedTransform
from gridtrack.recordings.native_messages import MAX_SWEEP_S
from gridtrack.recordings.read_options import CloudSlice, ReadOptions
from gridtrack.recordings.recording import DamageError

LASER_SCAN = "sensor_msgs/msg/LaserScan"
POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
POSES = (
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
)
POINT_FIELD_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


def ros2_name(kind: str) -> str:
    """`package/Name` of ROS 1 as ROS 2's `package/msg/Name`; other names as they are."""
    package, _, name = kind.partition("/")
    is_ros1 = bool(name) and not name.startswith(("msg/", "srv/", "action/"))
    return f"{package}/msg/{name}" if is_ros1 else kind


def stamp_ns(message: Any) -> int:
    """The stamp of a message's header, nanoseconds."""
    return int(message.header.stamp.sec) * 1_000_000_000 + int(message.header.stamp.nanosec)


def transform_of(translation: Any, rotation: Any) -> SE3 | None:
    """A geometry_msgs/Transform or Pose from its two parts; None where its numbers are not a transform."""
    return SE3.of((translation.x, translation.y, translation.z), (rotation.x, rotation.y, rotation.z, rotation.w))


def scan_of_laser(message: Any, sensor: str, received_ns: int) -> Scan:
    """A sensor_msgs/LaserScan as a scan; the stamp is that of the header, or of reception where the header has none."""
    return Scan(
        stamp_ns=stamp_ns(message) or received_ns,
        ranges=np.array(message.ranges, np.float32),
        angle_min=float(message.angle_min),
        angle_increment=float(message.angle_increment),
        range_min=float(message.range_min),
        range_max=float(message.range_max),
        sensor=sensor,
        time_increment_s=_time_increment_s(message),
    )


def _time_increment_s(message: Any) -> float:
    """The time between beams; 0, not known, where a driver writes one that no laser has."""
    increment_s = float(message.time_increment)
    return increment_s if 0.0 <= increment_s * max(len(message.ranges) - 1, 0) <= MAX_SWEEP_S else 0.0


def scan_of_cloud(message: Any, sensor: str, received_ns: int, cut: CloudSlice) -> Scan:
    """A height slice of a sensor_msgs/PointCloud2 as a scan: bearings from -pi to pi.

    A cloud without any point says nothing of free space, whatever an `empty` bearing means.
    """
    points = cloud_points(message)
    says_nothing = cut.empty == "unknown" or not len(points)
    points = points[(points[:, 2] >= cut.low_m) & (points[:, 2] <= cut.high_m)]
    distance = np.hypot(points[:, 0], points[:, 1])
    near = (distance >= cut.range_min_m) & (distance <= cut.range_max_m)
    step = 2.0 * math.pi / cut.beams
    bearing = np.arctan2(points[near, 1], points[near, 0])
    beam = np.floor((bearing + math.pi) / step).astype(np.int64) % cut.beams
    ranges = np.full(cut.beams, np.inf)
    np.minimum.at(ranges, beam, distance[near])
    if says_nothing:
        ranges[np.isinf(ranges)] = np.nan
    return Scan(
        stamp_ns=stamp_ns(message) or received_ns,
        ranges=ranges.astype(np.float32),
        angle_min=-math.pi + step / 2.0,
        angle_increment=step,
        range_min=cut.range_min_m,
        range_max=cut.range_max_m,
        sensor=sensor,
    )


def cloud_points(message: Any) -> NDArray[np.float64]:
    """x, y, z (N, 3) of a sensor_msgs/PointCloud2, metres, sensor frame; points with a NaN are left out.

    Raises RecordingError where the cloud lacks these fields, or has fewer bytes than its header declares.
    """
    rows, columns, step = message.height, message.width, message.point_step
    if not rows * columns:
        return np.empty((0, 3))  # a filter that lets nothing pass may write neither fields nor a row_step
    fields = {f.name: f for f in message.fields}
    order = ">" if message.is_bigendian else "<"
    row_step = message.row_step or columns * step  # 0 where a driver writes none
    data = np.asarray(message.data, np.uint8)
    if not {"x", "y", "z"} <= set(fields):
        raise RecordingError(f"a point cloud with the fields {', '.join(fields) or 'none'}; expected x, y and z")
    if row_step < columns * step or data.size < rows * row_step:
        raise RecordingError(f"a point cloud of {rows} x {columns} points in {data.size} bytes")
    axes = []
    for name in ("x", "y", "z"):
        kind = np.dtype(order + POINT_FIELD_TYPES.get(fields[name].datatype, "V1"))
        if kind.kind == "V" or fields[name].offset + kind.itemsize > step:
            raise RecordingError(f"a point cloud whose field '{name}' cannot be read")
        view = np.ndarray((rows, columns), kind, data.tobytes(), fields[name].offset, (row_step, step))
        axes.append(view.astype(np.float64).reshape(-1))
    points = np.stack(axes, axis=1)
    return points[np.isfinite(points).all(axis=1)]


try:
    from rosbags.serde import SerdeError
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore
except ImportError:
    raise RecordingError("reading ROS recordings needs rosbags: pip install 'gridtrack[ros]'") from None


class RosDecoder:
    """Decodes the messages of one recording, never by code made from the definitions in the recording itself."""

    @contextmanager
    def decoded(self, message: EncodedMessage) -> Iterator[Any]:
        """The decoded message. Raises DamageError where decoding it, or using it inside the block, fails."""
        try:
            yield self._decode(message)
        except (SerdeError, struct.error, ValueError, IndexError, UnicodeDecodeError) as error:
            raise DamageError(f"corrupt: a message of {message.topic} cannot be decoded ({error})") from None

    def _decode(self, message: EncodedMessage) -> Any:
        if message.encoding == "ros1":
            return self._ros1.deserialize_ros1(message.data, message.kind)
        if message.encoding == "cdr":
            return self._ros2.deserialize_cdr(message.data, message.kind)
        raise RecordingError(f"'{message.topic}' is encoded as '{message.encoding}'; expected ros1 or cdr")

    @cached_property
    def _ros1(self) -> Any:
        store = get_typestore(Stores.ROS1_NOETIC)
        for kind in TRANSFORMS:  # the packages of transforms are not in this store
            store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", kind))
        return store

    @cached_property
    def _ros2(self) -> Any:
        return get_typestore(Stores.LATEST)


ROS_OPTIONS = ("topic", "cloud_slice", "pose_topic", "mounts")


class RosRecording(FramedRecording):
    """A recording of ROS messages.

    Every LaserScan topic is a sensor; a PointCloud2 topic is read where the options name it, with the slice to cut from
    it.
    """

    def __init__(self, path: Path, options: ReadOptions) -> None:
        """Raises RecordingError where rosbags is not installed."""
        from gridtrack.recordings.ros_recording import RosDecoder

        super().__init__(path, options)
        self._decoder = RosDecoder()

    def content_of(self, message: EncodedMessage) -> Content | None:
        """What a message holds, from its topic and type."""
        if message.kind in (LASER_SCAN, POINT_CLOUD):
            return "scan"
        if message.kind in TRANSFORMS:
            return "transforms"
        return "pose" if message.kind in POSES else None

    def is_read(self, message: EncodedMessage) -> bool:
        """Whether the scans of a topic are read: point clouds only where the options name it."""
        return super().is_read(message) and (message.kind == LASER_SCAN or self.options.topic is not None)

    def frame_of(self, message: EncodedMessage) -> str:
        """The frame of a scan. Raises DamageError."""
        with self._decoder.decoded(message) as decoded:
            return str(decoded.header.frame_id)

    def transforms_of(self, message: EncodedMessage) -> Iterable[StampedTransform]:
        """The transforms of a message, or its pose; `child` is empty where it does not name one. DamageError."""
        with self._decoder.decoded(message) as decoded:
            if message.kind in TRANSFORMS:
                for t in decoded.transforms:
                    transform = transform_of(t.transform.translation, t.transform.rotation)
                    yield _stamped(message, t, t.child_frame_id, transform)
            else:
                pose = decoded.pose.pose if hasattr(decoded.pose, "pose") else decoded.pose
                transform = transform_of(pose.position, pose.orientation)
                yield _stamped(message, decoded, getattr(decoded, "child_frame_id", ""), transform)

    def scan_of(self, message: EncodedMessage) -> FramedScan:
        """A scan and its frame. Raises DamageError."""
        sensor = self.sensor_of(message.topic)
        with self._decoder.decoded(message) as decoded:
            if not stamp_ns(decoded):
                self.warn(f"topic '{message.topic}': no stamps in its headers, the time of reception is used")
            frame = str(decoded.header.frame_id)
            if message.kind == LASER_SCAN:
                return FramedScan(message.topic, frame, scan_of_laser(decoded, sensor, message.received_ns))
            if self.options.cloud_slice is None:
                raise RecordingError(f"'{message.topic}' is a point cloud: give the heights to cut it at")
            scan = scan_of_cloud(decoded, sensor, message.received_ns, self.options.cloud_slice)
            return FramedScan(message.topic, frame, scan)


def _stamped(message: EncodedMessage, decoded: Any, child: str, transform: SE3 | None) -> StampedTransform:
    """A transform with the stamp of its header, or of reception where the header has none."""
    return StampedTransform(stamp_ns(decoded) or message.received_ns, decoded.header.frame_id, child, transform)
