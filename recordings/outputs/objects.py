"""Messages with objects of trackers and predictors as one table.

Of a message type `OBJECT_MESSAGES` has the function that reads it, and the frame in which its velocities are by the
documentation of its package: that of the header (`world`), or the object's own (autoware).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from gridtrack.common.geometry import SE2
from gridtrack.recordings.frames.transform import SE3
from gridtrack.recordings.outputs.messages import Notes, OutputMessage, OutputTopics, in_plane
from gridtrack.recordings.outputs.object_table import (
    Numbers,
    ObjectList,
    PredictedPath,
    RecordedObject,
    TwistFrame,
    in_both_frames,
    outline_of,
    weighted,
)

AUTOWARE_LABELS = ("unknown", "car", "truck", "bus", "trailer", "motorcycle", "bicycle", "pedestrian")
CYLINDER, POLYGON = 1, 2
"""Types of autoware's Shape."""
LARGEST_VARIANCE_M2 = 100.0
"""A position with a greater variance has none: some nodes write 99999 for unknown."""


def read_objects(topics: OutputTopics, message_type: MessageType, notes: Notes) -> Iterator[ObjectList]:
    """The lists of objects on a topic, in the order of the file. Raises RecordingError."""
    for message in topics.messages(notes):
        yield ObjectList(message.stamp_ns, message.received_ns, tuple(message_type.read(message, notes)))


def _placed(
    message: OutputMessage,
    pose: Any,
    notes: Notes,
    *,
    track: object = "",
    velocity: Any = None,
    outline: Numbers,
    existence: float = 1.0,
    covariance: Any = None,
    paths: tuple[tuple[float, float, list[Any]], ...] = (),
) -> Iterator[RecordedObject]:
    """The object at a geometry_msgs/Pose in the frame of the message, in the world; none if it is not in the plane.

    `velocity` has x and y, m/s. `covariance` (36,) is that of a PoseWithCovariance. `paths`: probability, seconds
    between poses, and geometry_msgs/Poses from the present on.
    """
    placed = in_plane(message.world_T_frame, pose)
    if placed is None:
        notes.left_out[f"objects on {message.topic} with a pose that is not finite, tilted or upside down"] += 1
        return
    frame_rad = message.world_T_frame.placement().pose.theta
    given = None if velocity is None else np.array([velocity.x, velocity.y])
    yield RecordedObject(
        track=str(track),
        pose=_row(placed),
        velocities={} if given is None else in_both_frames(given, frame_rad, placed.theta),
        outline=outline,
        existence=float(existence),
        covariance=None if covariance is None else _in_world(covariance, frame_rad),
        paths=weighted([path for one in paths for path in _path(message.world_T_frame, *one)]),
    )


def _row(pose: SE2) -> Numbers:
    return np.array([pose.x, pose.y, pose.theta])


def _path(world_T_frame: SE3, probability: float, step_s: float, poses: list[Any]) -> Iterator[PredictedPath]:
    """The path of poses that are `step_s` apart; none if it has no motion, or poses that are not in the plane."""
    placed = [in_plane(world_T_frame, pose) for pose in poses]
    if len(placed) > 1 and step_s > 0.0 and None not in placed:
        rows = np.array([_row(pose) for pose in placed if pose is not None])
        yield PredictedPath(float(probability), np.arange(len(rows), dtype=np.float64) * step_s, rows)


def _in_world(covariance: Any, frame_rad: float) -> Numbers | None:
    """The covariance (2, 2) of the position, turned to the world; None if it is zero or no covariance."""
    numbers = np.asarray(covariance, np.float64).reshape(6, 6)[:2, :2]
    c, s = math.cos(frame_rad), math.sin(frame_rad)
    turn = np.array([[c, -s], [s, c]])
    if not np.isfinite(numbers).all():
        return None
    found: Numbers = turn @ ((numbers + numbers.T) / 2.0) @ turn.T
    smallest, largest = np.linalg.eigvalsh(found)
    return found if smallest >= 0.0 and 0.0 < largest <= LARGEST_VARIANCE_M2 else None


class _Point(NamedTuple):
    x: float
    y: float
    z: float = 0.0


class _Turn(NamedTuple):
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    w: float = 1.0


class _Pose(NamedTuple):
    position: Any
    orientation: Any = _Turn()


def _autoware(message: OutputMessage, notes: Notes) -> Iterator[RecordedObject]:
    for one in message.content.objects:
        kinematics, shape = one.kinematics, one.shape
        is_predicted = hasattr(kinematics, "predicted_paths")
        prefix = "initial_" if is_predicted else ""
        pose = getattr(kinematics, f"{prefix}pose_with_covariance")
        label = max(one.classification, key=lambda each: float(each.probability), default=None)
        number = 0 if label is None else int(label.label)
        name = AUTOWARE_LABELS[number] if number < len(AUTOWARE_LABELS) else "unknown"
        outline = outline_of(name, shape.dimensions.x, shape.dimensions.y, is_round=shape.type == CYLINDER)
        if shape.type == CYLINDER:
            outline = outline_of(name, shape.dimensions.x, shape.dimensions.x, is_round=True)
        elif shape.type == POLYGON and len(shape.footprint.points) > 2:
            outline = np.array([(point.x, point.y) for point in shape.footprint.points], np.float64)
        paths = (
            (path.confidence, path.time_step.sec + path.time_step.nanosec / 1e9, path.path)
            for path in (kinematics.predicted_paths if is_predicted else ())
        )
        yield from _placed(
            message,
            pose.pose,
            notes,
            track=np.asarray(one.object_id.uuid, np.uint8).tobytes().hex(),
            velocity=getattr(kinematics, f"{prefix}twist_with_covariance").twist.linear,
            outline=outline,
            existence=one.existence_probability,
            covariance=pose.covariance,
            paths=tuple(paths),
        )


def _spencer(message: OutputMessage, notes: Notes) -> Iterator[RecordedObject]:
    for one in message.content.tracks:
        yield from _placed(
            message,
            one.pose.pose,
            notes,
            track=one.track_id,
            velocity=one.twist.twist.linear,
            outline=outline_of("person", math.nan, math.nan),
            covariance=one.pose.covariance,
        )


def _people(message: OutputMessage, notes: Notes) -> Iterator[RecordedObject]:
    person = outline_of("person", math.nan, math.nan)
    for one in message.content.people:
        pose, existence = _Pose(one.position), one.reliability
        yield from _placed(
            message, pose, notes, track=one.name, velocity=one.velocity, outline=person, existence=existence
        )


def _leg_tracker(message: OutputMessage, notes: Notes) -> Iterator[RecordedObject]:
    person = outline_of("person", math.nan, math.nan)
    for one in message.content.people:
        yield from _placed(message, one.pose, notes, track=one.id, outline=person)


def _obstacles(message: OutputMessage, notes: Notes) -> Iterator[RecordedObject]:
    """Circles by their true radius (without the margin), and segments, which stand still."""
    for one in message.content.circles:
        diameter = 2.0 * float(one.true_radius)
        outline = outline_of("", diameter, diameter, is_round=True)
        yield from _placed(message, _Pose(one.center), notes, velocity=one.velocity, outline=outline)
    for one in message.content.segments:
        first, last = one.first_point, one.last_point
        outline = np.array([(0.0, 0.0), (last.x - first.x, last.y - first.y)])
        yield from _placed(message, _Pose(first), notes, velocity=_Point(0.0, 0.0), outline=outline)


def _detections(message: OutputMessage, notes: Notes) -> Iterator[RecordedObject]:
    """Boxes; a class and a score by the most probable hypothesis. ROS 1 has no track."""
    for one in message.content.detections:
        hypotheses = [getattr(result, "hypothesis", result) for result in one.results]
        best = max(hypotheses, key=lambda each: float(each.score), default=None)
        label = "" if best is None else str(getattr(best, "class_id", ""))
        yield from _placed(
            message,
            one.bbox.center,
            notes,
            track=getattr(one, "id", ""),
            outline=outline_of(label, one.bbox.size.x, one.bbox.size.y),
            existence=1.0 if best is None else best.score,
        )


class MessageType(NamedTuple):
    """How a type of message is read, and the frame of its velocities."""

    read: Callable[[OutputMessage, Notes], Iterator[RecordedObject]]
    twist_frame: TwistFrame = "world"


OBJECT_MESSAGES = {
    **{
        f"{package}/msg/{name}": MessageType(_autoware, "object")
        for package in ("autoware_perception_msgs", "autoware_auto_perception_msgs")
        for name in ("TrackedObjects", "PredictedObjects")
    },
    "spencer_tracking_msgs/msg/TrackedPersons": MessageType(_spencer),
    "people_msgs/msg/People": MessageType(_people),
    "leg_tracker/msg/PersonArray": MessageType(_leg_tracker),
    "obstacle_detector/msg/Obstacles": MessageType(_obstacles),
    "vision_msgs/msg/Detection3DArray": MessageType(_detections),
}
"""Name of a message -> how it is read."""
