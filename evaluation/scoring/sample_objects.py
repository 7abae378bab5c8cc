"""The objects of a sample as one `foxglove.SceneUpdate`: a cube for each, and an arrow as long as it moves in 1 s."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from gridtrack.evaluation.scoring.sample_grids import GRID_FRAME
from gridtrack.trackers.contract import TrackedObject

HEIGHT_M = 1.0
"""Height of the cubes in a viewer: a grid says nothing of it."""
HEAD_SHARE, HEAD_M = 0.3, 0.4
"""Length of an arrow's head: this share of the arrow, and at most this."""
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
    """The objects as a message, which replaces all those of the message before."""
    message = SceneUpdate()
    message.deletions.add(type=SceneEntityDeletion.ALL).timestamp.FromNanoseconds(stamp_ns)
    for one in objects:
        x, y, heading, length, width = one.box.tolist()
        entity = message.entities.add(id=str(one.track), frame_id=GRID_FRAME)
        entity.timestamp.FromNanoseconds(stamp_ns)
        cube = entity.cubes.add()
        _place(cube.pose, x, y, heading)
        cube.pose.position.z = HEIGHT_M / 2
        cube.size.x, cube.size.y, cube.size.z = length, width, HEIGHT_M
        vx, vy = one.velocity.tolist()
        speed = math.hypot(vx, vy)
        head_m = min(HEAD_SHARE * speed, HEAD_M)
        arrow = entity.arrows.add(
            shaft_length=speed - head_m, shaft_diameter=0.1, head_length=head_m, head_diameter=0.3
        )
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
        speed = arrow.shaft_length + arrow.head_length
        velocity = (speed * math.cos(towards), speed * math.sin(towards))
        if not all(map(math.isfinite, (*box, *velocity))):
            raise ValueError(f"object {entity.id!r} is not of finite numbers")
        objects.append(KeptObject(int(entity.id), box, velocity))
    return tuple(objects)


def _place(pose: Any, x: float, y: float, heading: float) -> None:
    pose.position.x, pose.position.y = x, y
    pose.orientation.z, pose.orientation.w = math.sin(heading / 2), math.cos(heading / 2)


def _heading(pose: Any) -> float:
    return 2 * math.atan2(pose.orientation.z, pose.orientation.w)
