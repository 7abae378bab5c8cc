"""ROS bags of a robot with two scanners that drives in a room past a person."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from gridtrack.common.geometry import SE2
from gridtrack.common.scan import Scan
from gridtrack.recordings.frames.transform import SE3

LASER, CLOUD = "sensor_msgs/msg/LaserScan", "sensor_msgs/msg/PointCloud2"
TF = "tf2_msgs/msg/TFMessage"
ODOMETRY, POSE = "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped"
ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.LATEST)
ROS1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
START_NS, MS = 1_700_000_000 * 10**9, 10**6
HALF_X_M, HALF_Y_M, PERSON_RADIUS_M = 6.0, 4.0, 0.3
DURATION_MS, SCANS = 2500, 25
"""A short drive: its duration, and the number of its scans at 10 Hz."""
STAMPS_MS = range(-40, DURATION_MS + 100, 40)
"""Stamps of its poses."""

Message = tuple[str, str, int, Any]
"""(topic, type, time of reception, message)."""


@dataclass(frozen=True)
class Laser:
    """A scanner on the robot: `base_T_laser`, upside down if `mirrored`."""

    name: str
    base_T_laser: SE2
    mirrored: bool = False
    beams: int = 181
    angle_min: float = -2.3
    angle_increment: float = 4.6 / 180
    offset_ms: int = 0


FRONT = Laser("front", SE2(0.3, 0.1, math.radians(30)))
REAR = Laser("rear", SE2(-0.3, 0.0, math.radians(180)), mirrored=True, offset_ms=40)


def robot_at(at_ms: float) -> SE2:
    """odom_T_base: a circle of 1.5 m at half a metre a second."""
    turned = at_ms / 3000.0
    return SE2(1.5 * math.cos(turned), 1.5 * math.sin(turned), turned + math.pi / 2)


def ranges_at(laser: Laser, odom_T_base: SE2, person: tuple[float, float]) -> NDArray[np.float32]:
    """The exact range of each beam to a wall or to the person."""
    pose = odom_T_base @ laser.base_T_laser
    angles = laser.angle_min + laser.angle_increment * np.arange(laser.beams)
    bearing = pose.theta + (-angles if laser.mirrored else angles)
    dx, dy = np.cos(bearing), np.sin(bearing)
    with np.errstate(divide="ignore"):
        to_walls = np.minimum((np.sign(dx) * HALF_X_M - pose.x) / dx, (np.sign(dy) * HALF_Y_M - pose.y) / dy)
    px, py = person[0] - pose.x, person[1] - pose.y
    along = px * dx + py * dy
    short = PERSON_RADIUS_M**2 - (px * px + py * py - along**2)
    to_person = np.where((short > 0) & (along > 0), along - np.sqrt(np.maximum(short, 0.0)), np.inf)
    return np.minimum(to_walls, to_person).astype(np.float32)


class Ros:
    """Messages of one version of ROS, stamped at milliseconds since the start."""

    def __init__(self, version: int) -> None:
        self.version, self.store = version, ROS1 if version == 1 else ROS2

    def make(self, kind: str, **fields: Any) -> Any:
        """A message; fields that are not given are zero, empty or false."""
        defined = self.store.fielddefs[kind][1]
        zeros = {name: self._zero(*node) for name, node in defined if name not in fields}
        return self.store.types[kind](**zeros, **fields)

    def _zero(self, node: Nodetype, of: Any) -> Any:
        if node == Nodetype.NAME:
            return self.make(of)
        if node == Nodetype.BASE:
            return "" if of[0] == "string" else np.dtype(of[0]).type().item()
        (item, of_item), length = of
        count = length if node == Nodetype.ARRAY else 0
        if item == Nodetype.BASE and of_item[0] != "string":
            return np.zeros(count, of_item[0])
        return [self._zero(item, of_item) for _ in range(count)]

    def header(self, at_ms: float, frame: str) -> Any:
        return self.stamped(START_NS + round(at_ms * MS), frame)

    def stamped(self, stamp_ns: int, frame: str) -> Any:
        """A header with this stamp, nanoseconds since 1970."""
        stamp = self.make("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)

    def laser_scan(self, scan: Scan, frame: str = "laser") -> Any:
        """The message of a scan."""
        return self.make(
            LASER,
            header=self.stamped(scan.stamp_ns, frame),
            angle_min=scan.angle_min,
            angle_max=scan.last_angle or scan.angle_min + scan.angle_increment * (scan.ranges.size - 1),
            angle_increment=scan.angle_increment,
            time_increment=scan.time_increment_s,
            scan_time=0.1,
            range_min=scan.range_min,
            range_max=scan.range_max,
            ranges=scan.ranges,
        )

    def laser(self, at_ms: float, ranges: NDArray[np.float32], laser: Laser, frame: str = "") -> Message:
        scan = Scan(START_NS + round(at_ms * MS), ranges, laser.angle_min, laser.angle_increment, 0.05, 20.0)
        return (f"/{laser.name}_scan", LASER, scan.stamp_ns, self.laser_scan(scan, frame or f"{laser.name}_laser"))

    def point_cloud(self, points: NDArray[np.float64], stamp_ns: int, frame: str = "laser") -> Any:
        """Points (N, 3) with padding and a field of another type in between, as in the messages of drivers."""
        kind = np.dtype({"names": ["x", "y", "z"], "formats": ["<f4"] * 3, "offsets": [0, 4, 8], "itemsize": 32})
        packed = np.zeros(len(points), kind)
        packed["x"], packed["y"], packed["z"] = points.T
        fields = [
            self.make("sensor_msgs/msg/PointField", name=name, offset=offset, datatype=datatype, count=1)
            for name, offset, datatype in (("x", 0, 7), ("y", 4, 7), ("ring", 16, 4), ("z", 8, 7))
        ]
        return self.make(
            CLOUD,
            header=self.stamped(stamp_ns, frame),
            height=1,
            width=len(points),
            fields=fields,
            point_step=32,
            row_step=32 * len(points),
            data=np.frombuffer(packed.tobytes(), np.uint8),
        )

    def cloud(self, at_ms: float, points: NDArray[np.float64], topic: str = "/points") -> Message:
        """Points (N, 3), metres, in the frame `lidar`."""
        stamp_ns = START_NS + round(at_ms * MS)
        return (topic, CLOUD, stamp_ns, self.point_cloud(points, stamp_ns, "lidar"))

    def transforms(self, at_ms: float, *links: tuple[str, str, SE3], topic: str = "/tf") -> Message:
        stamped = [
            self.make(
                "geometry_msgs/msg/TransformStamped",
                header=self.header(at_ms, parent),
                child_frame_id=child,
                transform=self.make(
                    "geometry_msgs/msg/Transform",
                    translation=self._vector("Vector3", transform),
                    rotation=self._quaternion(transform),
                ),
            )
            for parent, child, transform in links
        ]
        return (topic, TF, START_NS + round(at_ms * MS), self.make(TF, transforms=stamped))

    def odometry(
        self, at_ms: float, pose: SE2, topic: str = "/odom", frame: str = "odom", child: str = "base_link"
    ) -> Message:
        placed = self.make("geometry_msgs/msg/PoseWithCovariance", pose=self._pose(pose))
        message = self.make(ODOMETRY, header=self.header(at_ms, frame), child_frame_id=child, pose=placed)
        return (topic, ODOMETRY, START_NS + round(at_ms * MS), message)

    def pose(self, at_ms: float, pose: SE2, topic: str = "/pose", frame: str = "world") -> Message:
        message = self.make(POSE, header=self.header(at_ms, frame), pose=self._pose(pose))
        return (topic, POSE, START_NS + round(at_ms * MS), message)

    def write(
        self,
        path: Path,
        messages: Iterable[Message],
        storage: StoragePlugin = StoragePlugin.SQLITE3,
        compression: Any = None,
        chunk_bytes: int = 1 << 20,
    ) -> Path:
        """A bag of the messages in the order of their reception: a file for ROS 1, a folder for ROS 2.

        `storage` is for ROS 2, `chunk_bytes` for ROS 1. `compression` is a format for ROS 1, a mode for ROS 2.
        """
        opened: Any
        if self.version == 1:
            opened, encode = Writer1(path), ROS1.serialize_ros1
            opened.chunk_threshold = chunk_bytes
            if compression is not None:
                opened.set_compression(compression)
        else:
            opened, encode = Writer2(path, version=9, storage_plugin=storage), ROS2.serialize_cdr
            if compression is not None:
                opened.set_compression(compression, CompressionFormat.ZSTD)
        with opened as writer:
            connections: dict[str, Any] = {}
            for topic, kind, received_ns, message in sorted(messages, key=lambda m: m[2]):
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=self.store)
                writer.write(connections[topic], received_ns, encode(message, kind))
        return path

    def _pose(self, pose: SE2) -> Any:
        transform = SE3.in_plane(pose)
        return self.make(
            "geometry_msgs/msg/Pose", position=self._vector("Point", transform), orientation=self._quaternion(transform)
        )

    def _vector(self, kind: str, transform: SE3) -> Any:
        x, y, z = transform.translation
        return self.make(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)

    def _quaternion(self, transform: SE3) -> Any:
        x, y, z, w = transform.rotation
        return self.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def mounts(*lasers: Laser) -> list[tuple[str, str, SE3]]:
    """The transforms from base_link to each laser."""
    return [("base_link", f"{one.name}_laser", SE3.in_plane(one.base_T_laser, one.mirrored)) for one in lasers]


def scans_of(ros: Ros, duration_ms: int, *lasers: Laser) -> Iterator[Message]:
    """The scans of a drive at 10 Hz past a person who walks along a wall."""
    for at_ms in range(0, duration_ms, 100):
        for laser in lasers:
            stamp_ms = at_ms + laser.offset_ms
            person = (-5.0 + stamp_ms / 1000.0 % 10.0, 3.0)
            yield ros.laser(stamp_ms, ranges_at(laser, robot_at(stamp_ms), person), laser)


def odometry_transforms(ros: Ros, duration_ms: int) -> Iterator[Message]:
    """odom -> base_footprint at 50 Hz."""
    for at_ms in range(-20, duration_ms + 100, 20):
        yield ros.transforms(at_ms, ("odom", "base_footprint", SE3.in_plane(robot_at(at_ms))))


def localisation_transforms(ros: Ros, duration_ms: int) -> Iterator[Message]:
    """map -> odom at 1 Hz; it jumps by half a metre every second."""
    for k in range(duration_ms // 1000 + 1):
        yield ros.transforms(k * 1000, ("map", "odom", SE3.in_plane(SE2(0.5 * (k % 2), 0.0, 0.0))))


def two_scanner_drive(ros: Ros, duration_ms: int = 6000, static_at_ms: int = 0) -> list[Message]:
    """A drive as a navigation stack records it: /tf, /tf_static and two scanners, the rear one mirrored."""
    static = [("base_footprint", "base_link", SE3((0.0, 0.0, 0.1))), *mounts(FRONT, REAR)]
    return [
        ros.transforms(static_at_ms, *static, topic="/tf_static"),
        *odometry_transforms(ros, duration_ms),
        *localisation_transforms(ros, duration_ms),
        *scans_of(ros, duration_ms, FRONT, REAR),
    ]


def moving(
    ros: Ros, parent: str, child: str, *, topic: str = "/tf", ahead_ms: int = 0, backwards: bool = False
) -> list[Message]:
    """The transforms of a short drive. `ahead_ms`: of a robot that is ahead; `backwards`: the robot is the parent."""
    places = {at: robot_at(at + ahead_ms) for at in STAMPS_MS}
    return [
        ros.transforms(at, (parent, child, SE3.in_plane(pose.inverse() if backwards else pose)), topic=topic)
        for at, pose in places.items()
    ]


def odometry(ros: Ros, **names: str) -> list[Message]:
    """The odometry of a short drive."""
    return [ros.odometry(at, robot_at(at), **names) for at in STAMPS_MS]


def poses(ros: Ros, *topics: str) -> list[Message]:
    """The poses of a short drive on each topic, without a child frame."""
    return [ros.pose(at, robot_at(at), topic) for at in STAMPS_MS for topic in topics]


def at_rest(ros: Ros, *link: str, topic: str = "/tf") -> list[Message]:
    """Identity transforms from a parent to a child during a short drive."""
    parent, child = link
    return [ros.transforms(at, (parent, child, SE3()), topic=topic) for at in STAMPS_MS]


def walls_stay(scans: Iterable[Scan], count: int = SCANS) -> bool:
    """Whether there are `count` scans, and all their returns lie on the walls of the room."""
    off = [distance_to_walls(scan).max() for scan in scans]
    return len(off) == count and max(off) < 0.02


def distance_to_walls(scan: Scan) -> NDArray[np.float64]:
    """The distance of each return from the walls of the room, metres, without the beams on the person."""
    angles = scan.angle_min + scan.angle_increment * np.arange(scan.ranges.size)
    points = np.stack([np.cos(angles), np.sin(angles)], axis=1) * scan.ranges[:, None]
    points = scan.world_T_sensor.apply(points)
    inside = np.minimum(HALF_X_M - np.abs(points[:, 0]), HALF_Y_M - np.abs(points[:, 1]))
    on_person = np.abs(points[:, 1] - 3.0) < PERSON_RADIUS_M + 0.05
    return np.abs(inside[~on_person])
