"""Recordings of ROS: ROS 1 bags, ROS 2 bags (SQLite or MCAP) and MCAP files that hold ROS messages."""

from __future__ import annotations

import re
import struct
from abc import abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

from gridtrack.common.errors import RecordingError, did_you_mean
from gridtrack.common.geometry import SE2
from gridtrack.common.scan import Scan
from gridtrack.recordings.mcap_file import McapFile
from gridtrack.recordings.recording import DamageError, Recording, Topics
from gridtrack.recordings.ros_messages import (
    LASER_SCAN,
    POINT_CLOUD,
    CloudSlice,
    scan_of_cloud,
    scan_of_laser,
    stamp_ns,
)
from gridtrack.recordings.ros_poses import POSES, ScansOnPoses, planar_pose, why_not_read
from gridtrack.recordings.rosbag1 import bag_messages

try:
    from rosbags.rosbag2 import Reader, ReaderError
    from rosbags.serde import SerdeError
    from rosbags.typesys import Stores, get_typestore
except ImportError:
    raise RecordingError("reading ROS recordings needs rosbags: pip install gridtrack[ros]") from None


class RosMessage(NamedTuple):
    """One message, still encoded as `ros1` or `cdr`; `kind` as ROS 2 writes it, `package/msg/Name`."""

    topic: str
    kind: str
    received_ns: int
    encoding: str
    data: bytes


class RosRecording(Recording):
    """LaserScan topics as sensors; a PointCloud2 topic where it is asked for by name, with the slice to cut from it.

    Every sensor stands where the `pose_topic` says, or stands still without one; how it is mounted is not known.
    Messages are decoded by the definitions that rosbags ships, never by code made from the file's own.
    """

    def __init__(
        self,
        path: Path,
        topic: str | None = None,
        strict: bool = False,
        cloud_slice: CloudSlice | None = None,
        pose_topic: str | None = None,
    ) -> None:
        super().__init__(path, topic, strict)
        self.cloud_slice = cloud_slice
        self.pose_topic = pose_topic

    @abstractmethod
    def messages(self) -> Iterator[RosMessage]:
        """All messages in the order of the file. Raises DamageError where it is cut off or corrupt."""

    def read(self, topics: Topics) -> Iterator[Scan]:
        """The scans as they stand in the file; counts in `topics` what it meets; DamageError where the file ends."""
        placed = None if self.pose_topic is None else ScansOnPoses(self.pose_topic, self.complain)
        for message in self.messages():
            if placed is None and message.topic not in topics.types:
                self._tell_of_poses(message)
            topics.meet(message.topic, message.kind, message.kind in (LASER_SCAN, POINT_CLOUD))
            by_name = message.topic == self.topic and message.topic in topics.scans
            if by_name or (self.topic is None and message.kind == LASER_SCAN):
                scan = self._scan(message)
                yield from placed.scan(scan) if placed else (scan,)
            elif placed and message.topic == self.pose_topic and message.kind in POSES:
                yield from placed.pose(*self._pose(message))
        if placed:
            yield from placed.flush()
            self._refuse_no_poses(topics)

    def _tell_of_poses(self, message: RosMessage) -> None:
        told = why_not_read(message.topic, message.kind)
        if told is not None:
            self.tell(told)

    def _refuse_no_poses(self, topics: Topics) -> None:
        with_poses = [topic for topic, kind in topics.types.items() if kind in POSES]
        if self.pose_topic is not None and self.pose_topic not in with_poses:
            near = did_you_mean(self.pose_topic, with_poses)
            raise RecordingError(f"no topic '{self.pose_topic}' with poses; {near}")

    def _pose(self, message: RosMessage) -> tuple[int, SE2]:
        """Stamp and pose."""
        with _damaged_where_undecodable(message):
            decoded = self._decode(message)
            return stamp_ns(decoded) or message.received_ns, planar_pose(decoded)

    def _scan(self, message: RosMessage) -> Scan:
        sensor = message.topic.strip("/") or "scan"
        with _damaged_where_undecodable(message):
            decoded = self._decode(message)
            if not stamp_ns(decoded):
                self.complain(f"topic '{message.topic}': no stamps in its headers, the time of reception is used")
            if message.kind == LASER_SCAN:
                return scan_of_laser(decoded, sensor, message.received_ns)
            if self.cloud_slice is None:
                raise RecordingError(f"'{message.topic}' is a point cloud: give the heights to cut it at")
            return scan_of_cloud(decoded, sensor, message.received_ns, self.cloud_slice)

    def _decode(self, message: RosMessage) -> Any:
        if message.encoding == "ros1":
            return self._ros1.deserialize_ros1(message.data, message.kind)
        if message.encoding == "cdr":
            return self._ros2.deserialize_cdr(message.data, message.kind)
        raise RecordingError(f"'{message.topic}' is encoded as '{message.encoding}'; expected ros1 or cdr")

    @cached_property
    def _ros1(self) -> Any:
        return get_typestore(Stores.ROS1_NOETIC)

    @cached_property
    def _ros2(self) -> Any:
        return get_typestore(Stores.LATEST)


@contextmanager
def _damaged_where_undecodable(message: RosMessage) -> Iterator[None]:
    try:
        yield
    except (SerdeError, struct.error, ValueError, IndexError, UnicodeDecodeError) as error:
        raise DamageError(f"corrupt: a message of {message.topic} cannot be decoded ({error})") from None


class Ros1Bag(RosRecording):
    """A ROS 1 bag."""

    def messages(self) -> Iterator[RosMessage]:
        """All messages in the order of the file. Raises DamageError where it is cut off or corrupt."""
        for message in bag_messages(self.path):
            yield RosMessage(message.topic, _ros2_name(message.kind), message.received_ns, "ros1", message.data)


class RosMcap(RosRecording):
    """An MCAP file with ROS messages, or a folder of them as ROS 2 records it."""

    def messages(self) -> Iterator[RosMessage]:
        """All messages in the order of the file. Raises DamageError where it is cut off or corrupt."""
        for path in _parts(self.path, ".mcap"):
            for schema, channel, received_ns, data in McapFile(path).messages():
                yield RosMessage(channel.topic, _ros2_name(schema.name), received_ns, channel.message_encoding, data)


class Ros2Bag(RosRecording):
    """A ROS 2 bag kept in SQLite: its folder, or one `.db3` file."""

    def messages(self) -> Iterator[RosMessage]:
        """All messages in the order of reception. Raises DamageError where the bag is cut off or corrupt."""
        import apsw

        try:
            with Reader(self.path) as reader:
                for connection, received_ns, data in reader.messages():
                    yield RosMessage(connection.topic, connection.msgtype, received_ns, "cdr", data)
        except (ReaderError, apsw.Error, FileNotFoundError) as error:
            raise DamageError(f"damaged ({error})") from None


def is_ros2_folder_of_mcap(path: Path) -> bool:
    """Whether a folder holds a ROS 2 bag in MCAP files."""
    return bool(_parts(path, ".mcap"))


def _parts(path: Path, suffix: str) -> list[Path]:
    """The files of a recording in the order in which they were written: bag_2 before bag_10."""
    if not path.is_dir():
        return [path]

    def number(part: Path) -> tuple[int, str]:
        digits = re.search(r"(\d+)$", part.stem)
        return (int(digits[1]) if digits else 0, part.name)

    return sorted((p for p in path.iterdir() if p.suffix == suffix), key=number)


def _ros2_name(kind: str) -> str:
    """`package/Name` of ROS 1 as ROS 2's `package/msg/Name`."""
    package, _, name = kind.partition("/")
    return kind if name.startswith(("msg/", "srv/", "action/")) else f"{package}/msg/{name}"
