"""Annotated people in a native recording: a foxglove.SceneUpdate on `/people` for each scan in the annotated time.

The message has the scan's stamp and replaces the one before; a person is an entity with the track as its id, a
cylinder at its place in the world, and its speed in the metadata. Without persons it is empty: nobody was there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from gridtrack.common.scan import MAX_POSITION_M
from gridtrack.common.scene import Person
from gridtrack.recordings.file_reading import DamageError
from gridtrack.recordings.native_messages import (
    WORLD,
    empty_update,
    nanoseconds_of,
    read_scene_update,
    timestamp_of,
    track_of,
)
from gridtrack.recordings.people import PERSON_M

PEOPLE = "/people"
PERSON_HEIGHT_M = 1.7
PERSON_COLOUR = (0.8, 0.47, 0.65, 0.4)
"""RGBA, of the palette of the classes."""
_SPEED = "speed_mps"


def people_message(people: Sequence[Person], stamp_ns: int) -> SceneUpdate:
    """The message of the people at a stamp."""
    update = empty_update(stamp_ns)
    for person in people:
        entity = update.entities.add(id=str(person.track), frame_id=WORLD, timestamp=timestamp_of(stamp_ns))
        entity.metadata.add(key=_SPEED, value=repr(person.speed_mps))
        body = entity.cylinders.add(top_scale=1.0, bottom_scale=1.0)
        body.pose.position.x, body.pose.position.y, body.pose.position.z = person.x, person.y, PERSON_HEIGHT_M / 2.0
        body.pose.orientation.w = 1.0
        body.size.x = body.size.y = 2.0 * PERSON_M
        body.size.z = PERSON_HEIGHT_M
        body.color.r, body.color.g, body.color.b, body.color.a = PERSON_COLOUR
    return update


def read_people_message(data: bytes) -> tuple[int, tuple[Person, ...]]:
    """The stamp, and the people at it. Raises DamageError for an invalid message."""
    update = read_scene_update(PEOPLE, data)
    stamp_ns = nanoseconds_of(update.deletions[0].timestamp) if update.deletions else -1
    return stamp_ns, tuple(map(_person, update.entities))


def _person(entity: SceneEntity) -> Person:
    if len(entity.cylinders) != 1:
        raise DamageError(f"corrupt: a person of {PEOPLE} has {len(entity.cylinders)} cylinders; expected one")
    place = entity.cylinders[0].pose.position
    text = next((pair.value for pair in entity.metadata if pair.key == _SPEED), "")
    try:
        speed_mps = float(text)
    except ValueError:
        speed_mps = math.nan
    if not (max(abs(place.x), abs(place.y)) <= MAX_POSITION_M and 0.0 <= speed_mps < math.inf):
        raise DamageError(f"corrupt: a person of {PEOPLE} at {place.x:g}, {place.y:g} with a speed of {text[:20]!r}")
    return Person(track_of(entity.id), place.x, place.y, speed_mps)
