"""The true scene of a recording: outlines of all static and moving objects, also of hidden ones."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

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


class PlacedOutlines(NamedTuple):
    """K outlines in one frame: all `corners` (N, 2) float64, and the first corner of each, `starts` (K + 1,) int64."""

    corners: NDArray[np.float64]
    starts: NDArray[np.int64]

    @classmethod
    def of(cls, outlines: tuple[Outline, ...], poses: list[SE2]) -> PlacedOutlines:
        """Each of the `outlines` is given in its own frame, at one of the `poses`."""
        sizes = np.array([len(outline) for outline in outlines], np.int64)
        x, y = np.concatenate([np.zeros((0, 2)), *outlines]).T
        placed = [(pose.x, pose.y, math.cos(pose.theta), math.sin(pose.theta)) for pose in poses]
        dx, dy, cos, sin = np.repeat(np.array(placed).reshape(-1, 4), sizes, axis=0).T
        with np.errstate(invalid="ignore"):  # recordings/truth.py refuses corners that are not finite
            corners = np.stack([dx + cos * x - sin * y, dy + sin * x + cos * y], axis=1)
        return cls(corners, np.concatenate([np.zeros(1, np.int64), sizes.cumsum()]))


@dataclass(frozen=True)
class Scene:
    """All objects at one instant.

    `static` outlines in the world frame, `static_label` their class or UNLABELLED; `objects` are the road users.
    """

    static: tuple[Outline, ...]
    static_label: int
    objects: tuple[SceneObject, ...]

    @cached_property
    def outlines(self) -> PlacedOutlines:
        """All outlines in the world frame, static ones first; a window that moves draws each scene many times."""
        outlines = *self.static, *(body.outline for body in self.objects)
        return PlacedOutlines.of(outlines, [SE2()] * len(self.static) + [body.world_T_object for body in self.objects])

    @property
    def labels(self) -> NDArray[np.uint8]:
        """The class (K + 1,) of each of the `outlines`, and UNLABELLED at the end for the index -1."""
        of_objects = [body.label for body in self.objects]
        return np.array([*[self.static_label] * len(self.static), *of_objects, UNLABELLED], np.uint8)

    @cached_property
    def object_outlines(self) -> PlacedOutlines:
        """The outlines of the objects in the world frame."""
        corners, starts = self.outlines
        first = starts[len(self.static)]
        return PlacedOutlines(corners[first:], starts[len(self.static) :] - first)

    @property
    def static_outlines(self) -> PlacedOutlines:
        """The static outlines."""
        corners, starts = self.outlines
        return PlacedOutlines(corners[: starts[len(self.static)]], starts[: len(self.static) + 1])
