"""The grids of a sample as `foxglove.Grid`: fields of one byte per cell, and `shade`, by which a viewer colours."""

from __future__ import annotations

from typing import Any

import numpy as np
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from numpy.typing import NDArray

from gridtrack.common.grid import GridSpec, Mask
from gridtrack.evaluation.scoring.strata import PARTS
from gridtrack.evaluation.scoring.target import Target

GRID_FRAME = "grid"
"""The coordinate frame of every message of a sample: the window of frame t."""
OCCUPANCY_FIELDS = ("visible", "occupied")
SCORED_FIELDS = ("state", "in_motion")
PROBABILITY_FIELDS = ("probability",)
SHADE = "shade"
"""The field that a viewer colours by, the last one: 0 where nothing is known, small where free, 255 where occupied."""
FREE_SHADE = 64
_SHADE_OF_STATE = np.array([FREE_SHADE, 255, FREE_SHADE // 2, 191, 0], np.uint8)
"""Seen free, seen occupied, hidden and free, hidden and occupied, not scored: the states of `target.py`."""


def occupancy_planes(visible: Mask, occupied: Mask) -> NDArray[np.uint8]:
    """Three planes (M, M, 3) uint8: 255 where the cell is visible, 255 where it is occupied, and the shade."""
    shade = np.where(occupied, np.uint8(255), np.where(visible, np.uint8(FREE_SHADE), np.uint8(0)))
    return np.stack([visible * np.uint8(255), occupied * np.uint8(255), shade], axis=-1)


def scored_planes(target: Target, dynamic: Mask) -> NDArray[np.uint8]:
    """Three planes (M, M, 3) uint8: the state, 255 in the visible cells of the stratum in-motion, and the shade."""
    in_motion = target.frame.visible & dynamic & (target.motion != PARTS.index("standing"))
    return np.stack([target.state, in_motion * np.uint8(255), _SHADE_OF_STATE[target.state]], axis=-1)


def probability_plane(probability: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Probabilities (M, M) in [0, 1] as one plane (M, M, 1) uint8 of 255 steps."""
    return (probability * 255).round().astype(np.uint8)[..., None]


def grid_message(grid: GridSpec, stamp_ns: int, planes: NDArray[np.uint8], fields: tuple[str, ...]) -> Any:
    """A message with `planes` (M, M, F) as its `fields`: columns along x, rows along y, from the lower-left corner."""
    message = Grid(frame_id=GRID_FRAME, column_count=grid.size, data=planes.tobytes())
    message.timestamp.FromNanoseconds(stamp_ns)
    message.pose.position.x, message.pose.position.y = grid.origin
    message.pose.orientation.w = 1.0
    message.cell_size.x = message.cell_size.y = grid.cell_m
    message.cell_stride = len(fields)
    message.row_stride = len(fields) * grid.size
    for offset, name in enumerate(fields):
        message.fields.append(PackedElementField(name=name, offset=offset, type=PackedElementField.UINT8))
    return message


def planes_in(message: Any, grid: GridSpec, fields: tuple[str, ...]) -> NDArray[np.uint8]:
    """The `fields` of a message as (M, M, F) uint8, its layout checked before it is used; others after them are left.

    Raises ValueError.
    """
    stored = tuple(field.name for field in message.fields)
    count = len(stored)
    layout = (message.column_count, message.cell_stride, message.row_stride, len(message.data))
    expected = (grid.size, count, count * grid.size, count * grid.size**2)
    if layout != expected or stored[: len(fields)] != fields:
        raise ValueError(f"a grid of layout {layout}, expected {expected} with fields {fields}")
    return np.frombuffer(message.data, np.uint8).reshape(grid.size, grid.size, count)[..., : len(fields)]
