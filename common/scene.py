"""The true scene of a recording: outlines of all static and moving objects, also of hidden ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2

UNLABELLED = 255
"""The label of a beam, a cell or an outline of unknown class."""

Outline = NDArray[np.float32]
"""A simple closed polygon (N, 2) float32, metres, counter-clockwise; the last corner joins the first."""


@dataclass(frozen=True, slots=True)
class SceneObject:
    """A road user at one instant.

    `label` is an index into the recording's classes; `world_T_object` is the pose of the object's frame (x forward,
    origin at the centre of the body), `outline` is in that frame; `track` identifies the object over time.
    """

    track: int
    label: int
    world_T_object: SE2
    outline: Outline


@dataclass(frozen=True, slots=True)
class Person:
    """An annotated person at one instant: `track` identifies the person over time.

    `x`, `y` in metres, world frame; `speed_mps`, m/s.
    """

    track: int
    x: float
    y: float
    speed_mps: float = 0.0


@dataclass(frozen=True, slots=True)
class Scene:
    """All objects at one instant.

    `static` outlines in the world frame, `static_label` their class or UNLABELLED; `objects` are the road users.
    """

    static: tuple[Outline, ...]
    static_label: int
    objects: tuple[SceneObject, ...]
