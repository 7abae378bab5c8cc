"""ROS messages as scans: sensor_msgs/LaserScan, and a height slice of sensor_msgs/PointCloud2."""

from __future__ import annotations

import math
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from gridtrack.common.config import Settings
from gridtrack.common.errors import RecordingError
from gridtrack.common.scan import Scan

LASER_SCAN = "sensor_msgs/msg/LaserScan"
POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
POINT_FIELD_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


class CloudSlice(Settings):
    """How a point cloud becomes a scan: the nearest point of each bearing between two heights, metres, sensor frame.

    A bearing without a point in the slice is `empty`: "free" up to `range_max_m`, as if a laser's beam had not
    returned, or "unknown", as if there were no beam. Free is right where the cloud is dense and sees over whatever
    stands below the slice; with few rings, or a slice above low obstacles, it calls free what nobody has looked at:
    give a shorter `range_max_m`, or "unknown".
    """

    low_m: float
    high_m: float
    beams: int = Field(default=720, ge=1, le=36_000)
    range_min_m: float = Field(default=0.1, ge=0.0)
    range_max_m: float = Field(default=50.0, gt=0.0)
    empty: Literal["free", "unknown"] = "free"

    @model_validator(mode="after")
    def _limits_in_order(self) -> CloudSlice:
        if self.low_m >= self.high_m or self.range_min_m >= self.range_max_m:
            raise ValueError("the lower limit must be below the upper one")
        return self


def stamp_ns(message: Any) -> int:
    """The stamp of a message's header."""
    return int(message.header.stamp.sec) * 1_000_000_000 + int(message.header.stamp.nanosec)


def scan_of_laser(message: Any, sensor: str, received_ns: int) -> Scan:
    """A sensor_msgs/LaserScan as a scan, stamped by its header, or by its reception where the header has no stamp."""
    return Scan(
        stamp_ns=stamp_ns(message) or received_ns,
        ranges=np.array(message.ranges, np.float32),
        angle_min=float(message.angle_min),
        angle_increment=float(message.angle_increment),
        range_min=float(message.range_min),
        range_max=float(message.range_max),
        sensor=sensor,
    )


def scan_of_cloud(message: Any, sensor: str, received_ns: int, cut: CloudSlice) -> Scan:
    """A height slice of a sensor_msgs/PointCloud2 as a scan: bearings from -pi to pi, empty ones as `cut` says."""
    points = cloud_points(message)
    points = points[(points[:, 2] >= cut.low_m) & (points[:, 2] <= cut.high_m)]
    distance = np.hypot(points[:, 0], points[:, 1])
    near = (distance >= cut.range_min_m) & (distance <= cut.range_max_m)
    step = 2.0 * math.pi / cut.beams
    bearing = np.arctan2(points[near, 1], points[near, 0])
    beam = np.floor((bearing + math.pi) / step).astype(np.int64) % cut.beams
    ranges = np.full(cut.beams, np.inf)
    np.minimum.at(ranges, beam, distance[near])
    if cut.empty == "unknown":
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

    Raises RecordingError where the cloud has no such fields or fewer bytes than it says.
    """
    fields = {f.name: f for f in message.fields}
    order = ">" if message.is_bigendian else "<"
    rows, columns, step, row_step = message.height, message.width, message.point_step, message.row_step
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
