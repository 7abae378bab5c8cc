"""The messages of a native recording, for its reader and its writer.

A topic of one sensor is `KIND/SENSOR`, or `KIND` for the sensor `scan`. Foxglove has no schema for two kinds of
messages, which are JSON: `/beam_times` {timestamp, time_increment_s} is written where it changes, `/pose_quality`
{timestamp, outcome, inlier_share, residual_m} for each scan with a matched pose.

The true scene is in foxglove.SceneUpdate messages: `/outlines` has the static outlines, written where they change;
`/objects` the road users, once for each scan and with its stamp. The id of an entity is the object's track, its
metadata name the class, and its one line loop is the outline in the object's own frame; the pose of the line is
`world_T_object`. An object of several outlines, such as legs, has an entity for each: the further ids are the track, a
slash and a number.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.message import DecodeError
from google.protobuf.timestamp_pb2 import Timestamp

from gridtrack.common.errors import RecordingError
from gridtrack.common.geometry import SE2
from gridtrack.common.scan import MATCH_OUTCOMES, PoseQuality
from gridtrack.common.scene import UNLABELLED, Outline, Scene, SceneObject
from gridtrack.common.untrusted import parse_json
from gridtrack.recordings.file_reading import DamageError

NATIVE_SCHEMA = "1"
METADATA_NAME, WARNINGS_NAME = "gridtrack", "gridtrack.warnings"
REFERENCE_POSE, BEAM_TIMES, POSE_QUALITY = "/reference_pose", "/beam_times", "/pose_quality"
OUTLINES, OBJECTS = "/outlines", "/objects"
DEFAULT_SENSOR, WORLD = "scan", "world"
MAX_SWEEP_S = 10.0
"""Limit of the time from the first beam of a scan to the last."""
MAX_JSON_CHARS, MAX_SCENE_BYTES = 1000, 1 << 23
MAX_ENTITIES, MAX_ENTITY_CORNERS, MAX_TRACK, MAX_CACHED = 4096, 1024, 1 << 62, 4096
LINE_M = 0.06
CLASS_COLOURS = ((0.90, 0.62, 0.0), (0.34, 0.71, 0.91), (0.0, 0.62, 0.45), (0.84, 0.37, 0.0), (0.6, 0.6, 0.6))
"""RGB of the classes, repeated in their order: from the palette of Okabe and Ito (2008), safe for colour-blind
people."""

_TIMESTAMP = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
_NUMBER = {"type": "number"}
JSON_SCHEMAS: dict[str, dict[str, Any]] = {
    BEAM_TIMES: {"title": "gridtrack.BeamTimes", "time_increment_s": _NUMBER},
    POSE_QUALITY: {
        "title": "gridtrack.PoseQuality",
        "outcome": {"type": "string", "enum": list(MATCH_OUTCOMES)},
        "inlier_share": _NUMBER,
        "residual_m": _NUMBER,
    },
}
"""By kind of topic: the name of the schema, and the fields besides the timestamp."""


def topic_name(kind: str, sensor: str) -> str:
    """The topic of this kind (`/scan`, `/labels`, ...) with the messages of `sensor`."""
    return kind if sensor == DEFAULT_SENSOR else f"{kind}/{sensor}"


def is_topic(topic: str, kind: str) -> bool:
    """Whether `topic` is `topic_name(kind, sensor)` of any sensor."""
    return topic == kind or topic.startswith(f"{kind}/")


def timestamp_of(stamp_ns: int) -> Timestamp:
    """A stamp as a Protobuf timestamp."""
    return Timestamp(seconds=stamp_ns // 1_000_000_000, nanos=stamp_ns % 1_000_000_000)


def nanoseconds_of(timestamp: Timestamp) -> int:
    """A Protobuf timestamp as a stamp in nanoseconds."""
    return int(timestamp.seconds) * 1_000_000_000 + int(timestamp.nanos)


def set_pose(position: Vector3, orientation: Quaternion, pose: SE2) -> None:
    """Write a pose in the plane into a message."""
    position.x, position.y = pose.x, pose.y
    orientation.z, orientation.w = math.sin(pose.theta / 2.0), math.cos(pose.theta / 2.0)


def planar_pose(position: Vector3, orientation: Quaternion) -> SE2:
    """The pose in the plane that `set_pose` wrote."""
    return SE2(position.x, position.y, 2.0 * math.atan2(orientation.z, orientation.w))


def json_schema(kind: str) -> tuple[str, bytes]:
    """Name and JSON Schema of the messages of BEAM_TIMES or POSE_QUALITY."""
    fields = {"timestamp": _TIMESTAMP, **JSON_SCHEMAS[kind]}
    name = fields.pop("title")
    return name, json.dumps({"title": name, "type": "object", "properties": fields}).encode()


def beam_times_message(stamp_ns: int, time_increment_s: float) -> bytes:
    """A message of BEAM_TIMES."""
    return _json_message(stamp_ns, {"time_increment_s": time_increment_s})


def pose_quality_message(stamp_ns: int, quality: PoseQuality) -> bytes:
    """A message of POSE_QUALITY."""
    values = {"inlier_share": round(quality.inlier_share, 4), "residual_m": round(quality.residual_m, 5)}
    return _json_message(stamp_ns, {"outcome": quality.outcome, **values})


def read_beam_times(data: bytes) -> float:
    """The time between two beams, seconds. Raises DamageError."""
    increment_s = _number(_json_values(BEAM_TIMES, data), BEAM_TIMES, "time_increment_s")
    if not 0.0 <= increment_s <= MAX_SWEEP_S:
        raise DamageError(f"corrupt: {increment_s:g} s from beam to beam on {BEAM_TIMES}")
    return increment_s


def read_pose_quality(data: bytes) -> PoseQuality:
    """The quality of a pose. Raises DamageError."""
    values = _json_values(POSE_QUALITY, data)
    outcome = values.get("outcome")
    if outcome not in MATCH_OUTCOMES:
        raise DamageError(f"corrupt: an unknown outcome on {POSE_QUALITY}; expected {', '.join(MATCH_OUTCOMES)}")
    share, residual_m = (_number(values, POSE_QUALITY, name) for name in ("inlier_share", "residual_m"))
    if not (0.0 <= share <= 1.0 and 0.0 <= residual_m <= 1e6):
        raise DamageError(f"corrupt: a share of {share:g} or a residual of {residual_m:g} m on {POSE_QUALITY}")
    return PoseQuality(outcome, share, residual_m)


def _json_message(stamp_ns: int, values: dict[str, Any]) -> bytes:
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    return json.dumps({"timestamp": {"sec": seconds, "nsec": nanoseconds}, **values}).encode()


def _json_values(topic: str, data: bytes) -> dict[str, Any]:
    try:
        values = parse_json(data) if len(data) <= MAX_JSON_CHARS else None
    except ValueError:
        values = None
    if not isinstance(values, dict):
        raise DamageError(f"corrupt: a message of {topic} is not a {JSON_SCHEMAS[topic]['title']}")
    return values


def _number(values: dict[str, Any], topic: str, name: str) -> float:
    """The number called `name`; any comparison of a NaN with its limits is false."""
    value = values.get(name)
    if not isinstance(value, int | float):
        raise DamageError(f"corrupt: no number '{name}' on {topic}")
    return float(value)


class SceneWriter:
    """Converts scenes to messages; the constant parts of an object's entity are built once."""

    def __init__(self, classes: Sequence[str]) -> None:
        self._classes = classes
        self._static: tuple[Outline, ...] | None = None
        self._entities: dict[str, tuple[Outline, int, SceneEntity]] = {}

    def outlines(self, scene: Scene, stamp_ns: int) -> SceneUpdate | None:
        """The static outlines, or None if they are unchanged since the last call. Raises RecordingError."""
        if self._static is scene.static:
            return None
        self._static = scene.static
        update = empty_update(stamp_ns)
        for i, outline in enumerate(scene.static):
            update.entities.append(self._entity(f"static {i}", outline, scene.static_label))
            _place(update.entities[-1], SE2(), stamp_ns)
        return update

    def objects(self, scene: Scene, stamp_ns: int) -> SceneUpdate:
        """All objects; the message replaces the one before. Raises RecordingError."""
        update = empty_update(stamp_ns)
        outlines: Counter[int] = Counter()
        for road_user in scene.objects:
            part = outlines[road_user.track]
            outlines[road_user.track] += 1
            entity = self._cached_entity(f"{road_user.track}/{part}" if part else str(road_user.track), road_user)
            _place(entity, road_user.world_T_object, stamp_ns)
            update.entities.append(entity)
        return update

    def _cached_entity(self, name: str, road_user: SceneObject) -> SceneEntity:
        outline, label, entity = self._entities.get(name, (None, None, None))
        if entity is None or outline is not road_user.outline or label != road_user.label:
            if len(self._entities) >= MAX_CACHED:
                self._entities.clear()
            entity = self._entity(name, road_user.outline, road_user.label)
            self._entities[name] = (road_user.outline, road_user.label, entity)
        return entity

    def _entity(self, name: str, outline: Outline, label: int) -> SceneEntity:
        if label != UNLABELLED and label >= len(self._classes):
            raise RecordingError(f"'{name}' is of class {label}; the recording names only {len(self._classes)}")
        entity = SceneEntity(id=name, frame_id=WORLD)
        if label != UNLABELLED:
            entity.metadata.add(key="class", value=self._classes[label])
        line = entity.lines.add(type=LinePrimitive.LINE_LOOP, thickness=LINE_M)
        line.color.r, line.color.g, line.color.b = CLASS_COLOURS[label % len(CLASS_COLOURS)]
        line.color.a = 1.0
        for x, y in outline.astype(np.float64).tolist():
            line.points.add(x=x, y=y)
        return entity


def empty_update(stamp_ns: int) -> SceneUpdate:
    """An update that deletes the entities before it; the deletion has the stamp of the scan."""
    update = SceneUpdate()
    update.deletions.add(type=SceneEntityDeletion.ALL, timestamp=timestamp_of(stamp_ns))
    return update


def _place(entity: SceneEntity, world_T_object: SE2, stamp_ns: int) -> None:
    entity.timestamp.seconds, entity.timestamp.nanos = divmod(stamp_ns, 1_000_000_000)
    pose = entity.lines[0].pose
    set_pose(pose.position, pose.orientation, world_T_object)


class _Body(NamedTuple):
    name: str
    label: int
    outline: Outline


class SceneReader:
    """Converts messages to scenes; a body that does not change from scan to scan is read once and shared."""

    def __init__(self, classes: Sequence[str]) -> None:
        self._labels = {name: label for label, name in enumerate(classes)}
        self._static: tuple[Outline, ...] = ()
        self._static_label = UNLABELLED
        self._bodies: dict[bytes, _Body] = {}
        self._scene: tuple[int, Scene] | None = None

    def add(self, topic: str, data: bytes) -> None:
        """Read a message of OUTLINES or OBJECTS. Raises DamageError for an invalid or too large one."""
        update = read_scene_update(topic, data)
        placed = [(_pose(topic, entity), self._body(topic, entity)) for entity in update.entities]
        if topic == OUTLINES:
            self._static = tuple(_read_only(pose.apply(body.outline)) for pose, body in placed)
            self._static_label = placed[0][1].label if placed else UNLABELLED
            return
        objects = tuple(SceneObject(track_of(body.name), body.label, pose, body.outline) for pose, body in placed)
        stamp_ns = nanoseconds_of(update.deletions[0].timestamp) if update.deletions else -1
        self._scene = (stamp_ns, Scene(self._static, self._static_label, objects))

    def scene_at(self, stamp_ns: int) -> Scene | None:
        """The scene at `stamp_ns`; None if the last message of OBJECTS has another stamp."""
        return self._scene[1] if self._scene is not None and self._scene[0] == stamp_ns else None

    def _body(self, topic: str, entity: SceneEntity) -> _Body:
        """The name, class and outline of an entity. Clears its pose and stamp: the rest is the key of the cache."""
        entity.ClearField("timestamp")
        for line in entity.lines:
            line.ClearField("pose")
        key = entity.SerializeToString(deterministic=True)
        if key not in self._bodies:
            if len(self._bodies) >= MAX_CACHED:
                self._bodies.clear()
            self._bodies[key] = self._read_body(topic, entity)
        return self._bodies[key]

    def _read_body(self, topic: str, entity: SceneEntity) -> _Body:
        name = next((pair.value for pair in entity.metadata if pair.key == "class"), None)
        if name is not None and name not in self._labels:
            raise DamageError(f"corrupt: an entity of {topic} has a class that the recording does not name")
        if not 3 <= len(entity.lines[0].points) <= MAX_ENTITY_CORNERS:
            raise DamageError(f"corrupt: an entity of {topic} is not an outline of 3 to {MAX_ENTITY_CORNERS} corners")
        outline = _read_only([(point.x, point.y) for point in entity.lines[0].points])
        if not np.isfinite(outline).all():
            raise DamageError(f"corrupt: an outline of {topic} has a corner that is not finite")
        return _Body(entity.id, UNLABELLED if name is None else self._labels[name], outline)


def read_scene_update(topic: str, data: bytes) -> SceneUpdate:
    """A message of `topic`, of a bounded size. Raises DamageError."""
    if len(data) > MAX_SCENE_BYTES:
        raise DamageError(f"corrupt: a message of {topic} of {len(data)} bytes; at most {MAX_SCENE_BYTES} are read")
    update = SceneUpdate()
    try:
        update.ParseFromString(data)
    except DecodeError:
        raise DamageError(f"corrupt: a message of {topic} is not a foxglove.SceneUpdate") from None
    if len(update.entities) > MAX_ENTITIES:
        raise DamageError(f"corrupt: {len(update.entities)} entities in a message of {topic}; at most {MAX_ENTITIES}")
    return update


def _pose(topic: str, entity: SceneEntity) -> SE2:
    if len(entity.lines) != 1:
        raise DamageError(f"corrupt: an entity of {topic} has {len(entity.lines)} lines; expected its outline")
    found = entity.lines[0].pose
    pose = planar_pose(found.position, found.orientation)
    if not math.isfinite(pose.x + pose.y + pose.theta):
        raise DamageError(f"corrupt: an entity of {topic} is at {pose.x:g}, {pose.y:g}; expected a finite pose")
    return pose


def _read_only(corners: object) -> Outline:
    outline = np.array(corners, np.float32)
    outline.flags.writeable = False
    return outline


def track_of(name: str) -> int:
    """The track of an entity with the id `name`. Raises DamageError."""
    name = name.partition("/")[0]
    if name.isascii() and name.isdecimal() and len(name) < 20 and int(name) < MAX_TRACK:
        return int(name)
    raise DamageError(f"corrupt: an object's id is not a track number below {MAX_TRACK}")
