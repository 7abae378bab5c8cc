"""The shape of a track: boundary points in the body's frame, each as often occupied as it has been of late."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import GridSpec, Mask
from gridtrack.trackers.model_free.arrays import Array
from gridtrack.trackers.model_free.ragged import split

MAX_POINTS = 256
"""The most boundary points that a track carries; the weakest go first."""
ESTABLISHED_FRAMES = 8
"""For as many frames a boundary point must have been there to be of the body, and not the trail of what leaves it."""
HIDDEN_FADES = 0.1
"""A boundary point whose place is hidden fades at this share of the speed of one that is seen not to be there."""
REVEALED = 0.5
"""How likely a boundary point is at first whose place was hidden before: it may always have been there."""
FORGOTTEN = 0.6
"""A boundary point that is less likely than a new one by this factor is dropped."""


@dataclass(slots=True)
class Shape:
    """Boundary points `offsets` (N, 2) in the body's frame, metres, and `weights` (N,) in [0, 1].

    The weight of a point is the share of the frames of late in which a return was there. A point whose place is hidden
    keeps it for longer: a vehicle's far side is remembered. `ages` (N,) say for how many frames each has been there; at
    those that are `cut` (N,) the boundary may go on unseen; `frames` counts those that the shape was made from.
    """

    offsets: Array
    weights: Array
    ages: NDArray[np.int64]
    cut: Mask
    frames: int = 0

    @classmethod
    def of(cls, offsets: Array, cut: Mask, apart_m: float) -> Shape:
        """The shape that one frame's points make, as points that are at least `apart_m` from each other.

        It is `cut` off (N,) at some of them.
        """
        shape = cls(np.empty((0, 2)), np.empty(0), np.empty(0, np.int64), np.empty(0, np.bool_))
        revealed = np.zeros(len(offsets), np.bool_)
        shape.absorb(offsets, cut, revealed, np.empty(0, np.bool_), apart_m, gain=0.0)
        return shape

    def absorb(self, found: Array, found_cut: Mask, revealed: Mask, in_view: Mask, apart_m: float, gain: float) -> None:
        """Take in one frame's points `found` (K, 2), body's frame, and at which of them it is cut off (K,).

        A boundary point within `apart_m` of one is met and gains the share `gain`; one that is not met loses it, slowly
        if it is not `in_view` (N,); a point that meets none is a new one, which had been seen not to be there unless
        its place is `revealed` (K,) now. The first frames count alike.
        """
        gain = max(gain, 1.0 / (self.frames + 1))
        self.offsets, self.weights, self.ages, self.cut = _absorb(
            *(self.offsets, self.weights, self.ages, self.cut),
            *(found, found_cut, revealed, in_view, apart_m, gain),
        )
        self.frames += 1

    def extend(self, other: Shape, offsets: Array) -> None:
        """Add the boundary points of another shape, which lie at `offsets` (K, 2) in this body's frame."""
        weights = np.concatenate([self.weights, other.weights])
        strongest = np.argsort(-weights, kind="stable")[:MAX_POINTS]
        self.offsets = np.concatenate([self.offsets, offsets])[strongest]
        self.weights, self.ages = weights[strongest], np.concatenate([self.ages, other.ages])[strongest]
        self.cut = np.concatenate([self.cut, other.cut])[strongest]

    @property
    def established(self) -> Mask:
        """Which points (N,) have been there for long, or in a young shape from the start."""
        return np.asarray(self.ages >= min(ESTABLISHED_FRAMES, self.ages.max()))

    @property
    def extent_m(self) -> float:
        """The longer side of the points' bounding box in the body's frame."""
        return float(np.ptp(self.offsets, axis=0).max())


def to_body(points: Array, pose: Array) -> Array:
    """Points (N, 2) of the grid frame in the frame of a body at `pose` (3,); or (N, 3), each in that of its own."""
    (x, y), (cosine, sine) = (points - pose[..., :2]).T, (np.cos(pose[..., 2]), np.sin(pose[..., 2]))
    return np.stack([cosine * x + sine * y, cosine * y - sine * x], axis=1)


def to_grid(points: Array, pose: Array) -> Array:
    """The way back from `to_body`."""
    (x, y), (cosine, sine) = points.T, (np.cos(pose[..., 2]), np.sin(pose[..., 2]))
    return np.asarray(pose[..., :2] + np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=1))


def rotation(angle: float) -> Array:
    """Rotation matrix (2, 2)."""
    cosine, sine = math.cos(angle), math.sin(angle)
    return np.array([[cosine, -sine], [sine, cosine]])


def in_view(boundaries: Sequence[Array], grid: GridSpec, visible: Mask) -> list[Mask]:
    """Which points of each boundary (N, 2), metres, grid frame, lie in a visible cell; none does outside the grid."""
    if not boundaries:
        return []
    cells, inside = grid.cells_of(np.concatenate(boundaries))
    seen = inside.copy()
    seen[inside] = visible[cells[inside, 0], cells[inside, 1]]
    return split(seen, boundaries)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _absorb(offsets, weights, ages, cut, found, found_cut, revealed, in_view, apart_m, gain):  # type: ignore
    """Boundary points (N', 2), weights, ages and whether cut off (N',) after one frame; see `Shape.absorb`."""
    known = len(offsets)
    total = known
    points, likely = np.empty((known + len(found), 2)), np.zeros(known + len(found))
    points[:known], likely[:known] = offsets, weights
    met, ends = np.zeros((2, known + len(found)), np.bool_)
    ends[:known] = cut
    for k in range(len(found)):
        nearest, distance = -1, apart_m * apart_m
        for j in range(total):
            dx, dy = found[k, 0] - points[j, 0], found[k, 1] - points[j, 1]
            if dx * dx + dy * dy < distance:
                nearest, distance = j, dx * dx + dy * dy
        if nearest < 0:
            points[total] = found[k]
            likely[total] = REVEALED if revealed[k] else 0.0
            met[total], ends[total] = True, found_cut[k]
            total += 1
        else:
            ends[nearest] = found_cut[k] and (ends[nearest] or not met[nearest])
            met[nearest] = True
    for j in range(total):
        if met[j]:
            likely[j] += gain * (1.0 - likely[j])
        else:
            likely[j] -= gain * likely[j] * (1.0 if in_view[j] else HIDDEN_FADES)
    kept = np.flatnonzero(likely[:total] > FORGOTTEN * gain)
    if len(kept) > MAX_POINTS:
        kept = np.sort(kept[np.argsort(likely[kept])[-MAX_POINTS:]])
    older = np.ones(total, np.int64)
    older[:known] += ages
    return points[kept], likely[kept], older[kept], ends[kept]
