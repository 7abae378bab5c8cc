"""ROS messages as scans and transforms: sensor_msgs/LaserScan, a height slice of sensor_msgs/PointCloud2, poses."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.errors import RecordingError
from gridtrack.common.scan import Scan
from gridtrack.recordings.frames.transform import SE3
from gridtrack.recordings.json_messages import MAX_SWEEP_S
from gridtrack.recordings.read_options import CloudSlice

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
