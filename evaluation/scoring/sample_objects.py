"""The objects of a sample as one `foxglove.SceneUpdate`: a cube for each, and an arrow as long as it moves in 1 s."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from gridtrack.trackers.contract import TrackedObject

HEIGHT_M = 1.0
"""Height of the cubes in a viewer: a grid says nothing of it."""
_RGBA = (0.1, 0.45, 0.9, 0.5)


@dataclass(frozen=True, slots=True)
class KeptObject:
    """One object of a forecast at step 0, in the grid frame.

    `box`: x, y, heading, length along it, width (metres, radians); `velocity`: m/s.
    """

    track: int
    box: tuple[float, float, float, float, float]
    velocity: tuple[float, float]


def objects_message(objects: Sequence[TrackedObject], stamp_ns: int) -> Any:
    """The objects as a message, each an entity that a later message of the same id replaces."""
    message = SceneUpdate()
    for one in objects:
        x, y, heading, length, width = one.box.tolist()
        entity = message.entities.add(id=str(one.track), frame_id="grid")
        entity.timestamp.FromNanoseconds(stamp_ns)
        cube = entity.cubes.add()
        _place(cube.pose, x, y, heading)
        cube.size.x, cube.size.y, cube.size.z = length, width, HEIGHT_M
        vx, vy = one.velocity.tolist()
        arrow = entity.arrows.add(shaft_length=math.hypot(vx, vy), shaft_diameter=0.1)
        _place(arrow.pose, x, y, math.atan2(vy, vx))
        for colour in (cube.color, arrow.color):
            colour.r, colour.g, colour.b, colour.a = _RGBA
    return message


def objects_of(message: Any) -> tuple[KeptObject, ...]:
    """The objects of a message of `objects_message`. Raises ValueError where one has another form."""
    objects = []
    for entity in message.entities:
        if len(entity.cubes) != 1 or len(entity.arrows) != 1:
            raise ValueError(f"object {entity.id!r} is not one cube with one arrow")
        (cube,), (arrow,) = entity.cubes, entity.arrows
        place, towards = cube.pose.position, _heading(arrow.pose)
        box = (place.x, place.y, _heading(cube.pose), cube.size.x, cube.size.y)
        velocity = (arrow.shaft_length * math.cos(towards), arrow.shaft_length * math.sin(towards))
        if not all(map(math.isfinite, (*box, *velocity))):
            raise ValueError(f"object {entity.id!r} is not of finite numbers")
        objects.append(KeptObject(int(entity.id), box, velocity))
    return tuple(objects)


def _place(pose: Any, x: float, y: float, heading: float) -> None:
    pose.position.x, pose.position.y = x, y
    pose.orientation.z, pose.orientation.w = math.sin(heading / 2), math.cos(heading / 2)


def _heading(pose: Any) -> float:
    return 2 * math.atan2(pose.orientation.z, pose.orientation.w)
