"""ROS bags with a standing laser and the outputs of a stack: occupancy grids, grid maps, objects."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import get_types_from_msg

from gridtrack.common.geometry import SE2
from gridtrack.recordings.frames.transform import SE3
from gridtrack.recordings.output_definitions import ROS1_OUTPUTS, ROS2_OUTPUTS

from scenes.drive_bag import FRONT, MS, ROS1, ROS2, START_NS, Message, Ros

for store, definitions in ((ROS1, ROS1_OUTPUTS), (ROS2, ROS2_OUTPUTS)):
    for kind, text in definitions.items():
        store.register(get_types_from_msg(text, kind))

GRID, GRID_MAP = "nav_msgs/msg/OccupancyGrid", "grid_map_msgs/msg/GridMap"
FRAME, DELAY_MS = "front_laser", 30
"""The frame of the laser, which is the world without transforms; time from a stamp to the reception of an output."""
WALL_M = 6.0
AUTOWARE = "autoware_perception_msgs/msg"


def standing_scans(ros: Ros, duration_ms: int = 2000) -> Iterator[Message]:
    """A laser at rest that sees a round wall, at 10 Hz."""
    for at_ms in range(0, duration_ms, 100):
        yield ros.laser(at_ms, np.full(FRONT.beams, WALL_M, np.float32), FRONT)


class Outputs:
    """Makes messages of outputs, received DELAY_MS after their stamps."""

    def __init__(self, ros: Ros) -> None:
        self.ros = ros

    def message(self, topic: str, kind: str, at_ms: float, delay_ms: float = DELAY_MS, **fields: Any) -> Message:
        return (topic, kind, START_NS + round((at_ms + delay_ms) * MS), self.ros.make(kind, **fields))

    def pose(self, pose: SE2) -> Any:
        return self.ros._pose(pose)

    def grid(
        self,
        topic: str,
        at_ms: float,
        values: Any,
        origin: SE2,
        *,
        cell_m: float = 0.5,
        frame: str = FRAME,
        delay_ms: float = DELAY_MS,
        **info: Any,
    ) -> Message:
        """An occupancy grid of `values` (H, W), percentages; `info` replaces fields of its MapMetaData."""
        values = np.asarray(values, np.int8)
        fields: dict[str, Any] = {
            "resolution": cell_m,
            "width": values.shape[1],
            "height": values.shape[0],
            "origin": self.pose(origin),
        }
        header = self.ros.header(at_ms, frame)
        meta = self.ros.make("nav_msgs/msg/MapMetaData", **(fields | info))
        return self.message(topic, GRID, at_ms, delay_ms, header=header, info=meta, data=values.reshape(-1))

    def grid_map(self, at_ms: float, matrix: NDArray[np.float32], start: tuple[int, int], centre: SE2) -> Message:
        """A grid map with the layer `p`; `matrix` is its buffer as the sender keeps it, rows along -x."""
        rows, columns = matrix.shape
        dims = [
            self.ros.make("std_msgs/msg/MultiArrayDimension", label=label, size=size, stride=stride)
            for label, size, stride in (("column_index", columns, matrix.size), ("row_index", rows, rows))
        ]
        layout = self.ros.make("std_msgs/msg/MultiArrayLayout", dim=dims, data_offset=0)
        layer = self.ros.make("std_msgs/msg/Float32MultiArray", layout=layout, data=matrix.T.reshape(-1))
        other = self.ros.make("std_msgs/msg/Float32MultiArray", layout=layout, data=np.full(matrix.size, 7, np.float32))
        headed = {"header": self.ros.header(at_ms, FRAME)}
        size = {"resolution": 0.5, "length_x": 0.5 * rows, "length_y": 0.5 * columns, "pose": self.pose(centre)}
        info = self.ros.make("grid_map_msgs/msg/GridMapInfo", **size, **(headed if self.ros.version == 1 else {}))
        return self.message(
            "/map",
            GRID_MAP,
            at_ms,
            info=info,
            layers=["elevation", "p"],
            data=[other, layer],
            outer_start_index=start[0],
            inner_start_index=start[1],
            **(headed if self.ros.version == 2 else {}),
        )

    def objects(self, at_ms: float, *objects: Any, frame: str = FRAME, delay_ms: float = DELAY_MS) -> Message:
        """A list of cars, all predicted or all tracked ones."""
        kind = f"{objects[0].__msgtype__}s" if objects else f"{AUTOWARE}/PredictedObjects"
        return self.message(
            "/objects", kind, at_ms, delay_ms, header=self.ros.header(at_ms, frame), objects=list(objects)
        )

    def car(
        self,
        pose: SE2,
        twist: tuple[float, float],
        *,
        existence: float = 1.0,
        paths: tuple[tuple[float, list[SE2]], ...] = (),
        label: int = 1,
        size: tuple[float, float] = (4.0, 2.0),
        number: int = 7,
        kind: str = f"{AUTOWARE}/PredictedObject",
    ) -> Any:
        """A PredictedObject or a TrackedObject; `paths`: confidence and poses that are half a second apart."""
        make, package, is_predicted = self.ros.make, kind.rpartition("/")[0], kind.endswith("PredictedObject")
        linear = make("geometry_msgs/msg/Vector3", x=twist[0], y=twist[1])
        motion = {
            "pose_with_covariance": make("geometry_msgs/msg/PoseWithCovariance", pose=self.pose(pose)),
            "twist_with_covariance": make(
                "geometry_msgs/msg/TwistWithCovariance",
                twist=make("geometry_msgs/msg/Twist", linear=linear),
            ),
        }
        if is_predicted:
            motion = {f"initial_{name}": value for name, value in motion.items()}
            motion["predicted_paths"] = [
                make(
                    f"{package}/PredictedPath",
                    path=[self.pose(one) for one in poses],
                    time_step=make("builtin_interfaces/msg/Duration", nanosec=500 * MS),
                    confidence=confidence,
                )
                for confidence, poses in paths
            ]
        dimensions = make("geometry_msgs/msg/Vector3", x=size[0], y=size[1], z=1.5)
        return make(
            kind,
            object_id=make("unique_identifier_msgs/msg/UUID", uuid=np.full(16, number, np.uint8)),
            existence_probability=existence,
            classification=[make(f"{package}/ObjectClassification", label=label, probability=0.9)],
            kinematics=make(f"{kind}Kinematics", **motion),
            shape=make(f"{package}/Shape", dimensions=dimensions),
        )

    def leg_trackers(self, at_ms: float, *people: tuple[int, float, float]) -> Message:
        """People by number, x and y."""
        found = [
            self.ros.make("leg_tracker/msg/Person", pose=self.pose(SE2(x, y)), id=number) for number, x, y in people
        ]
        header = self.ros.header(at_ms, FRAME)
        return self.message("/people", "leg_tracker/msg/PersonArray", at_ms, header=header, people=found)


def write_bag(folder: Path, ros: Ros, *messages: Message) -> Path:
    """A bag of the standing laser and messages."""
    return ros.write(folder / ("a.bag" if ros.version == 1 else "bag"), [*standing_scans(ros), *messages])


def box_cells(x: tuple[float, float], y: tuple[float, float], cell_m: float, size: int) -> NDArray[np.bool_]:
    """The outline cells (M, M) of a box between two x and two y, metres, in a window about the origin."""
    cells = np.zeros((size, size), np.bool_)
    (left, right), (bottom, top) = ([math.floor(v / cell_m + size / 2) for v in ends] for ends in (x, y))
    cells[bottom : top + 1, [left, right]] = True
    cells[[bottom, top], left : right + 1] = True
    return cells


def laser_link(ros: Ros, world: str, pose: SE2) -> Message:
    """A static transform from a frame to that of the laser."""
    return ros.transforms(0, (world, FRAME, SE3.in_plane(pose)), topic="/tf_static")
