"""The shape of a track: boundary points in the body frame, each with its recent rate of occupancy."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import GridSpec, Mask
from gridtrack.trackers.model_free.arrays import Array, split

MAX_POINTS = 256
"""Maximum number of boundary points; the points of smallest weight are removed first."""
ESTABLISHED_FRAMES = 8
"""Older boundary points belong to the body; younger ones may be the trail of an object that leaves it."""
HIDDEN_DECAY = 0.1
"""Decay rate of the weight of a hidden boundary point, relative to a point in view without a return."""
REVEALED_WEIGHT = 0.5
"""Initial weight of a boundary point at a position that was hidden before: it may have existed all the time."""
REMOVE_BELOW = 0.6
"""A boundary point is removed below this multiple of the weight of a new point."""


@dataclass(slots=True)
class Shape:
    """Boundary points `offsets` (N, 2) in the body frame, metres, and `weights` (N,) in [0, 1].

    The weight of a point is the share of the recent frames in which it had a return. The weight of a hidden point
    decays more slowly: the far side of a vehicle is remembered. `ages` (N,) are in frames; at points that are `cut`
    off (N,) an occluder may hide the continuation of the boundary; `frames` is the number of frames in the shape.
    """

    offsets: Array
    weights: Array
    ages: NDArray[np.int64]
    cut: Mask
    frames: int = 0

    @classmethod
    def of(cls, offsets: Array, cut: Mask, apart_m: float) -> Shape:
        """The shape of the points of one frame, thinned to a spacing of `apart_m`; some are `cut` off (N,)."""
        shape = cls(np.empty((0, 2)), np.empty(0), np.empty(0, np.int64), np.empty(0, np.bool_))
        revealed = np.zeros(len(offsets), np.bool_)
        shape.update(offsets, cut, revealed, np.empty(0, np.bool_), apart_m, gain=0.0)
        return shape

    def update(self, found: Array, found_cut: Mask, revealed: Mask, in_view: Mask, apart_m: float, gain: float) -> None:
        """Update with the points `found` (K, 2) in one frame, body frame; `found_cut` (K,) are cut off.

        A boundary point within `apart_m` of a found point is matched: its weight approaches 1 by the share `gain`. The
        weight of an unmatched point approaches 0, slowly if it is not `in_view` (N,). A found point without a match is
        a new boundary point, of weight 0 before this frame unless its position is `revealed` (K,). The first frames of
        a shape have equal weight.
        """
        gain = max(gain, 1.0 / (self.frames + 1))
        known, most = len(self.offsets), len(self.offsets) + len(found)
        points, weights, ages = np.zeros((most, 2)), np.zeros(most), np.ones(most, np.int64)
        cut = np.zeros(most, np.bool_)
        points[:known], weights[:known], cut[:known] = self.offsets, self.weights, self.cut
        ages[:known] += self.ages
        total = _update(points, weights, cut, known, found, found_cut, revealed, in_view, apart_m, gain)
        kept = np.flatnonzero(weights[:total] > REMOVE_BELOW * gain)
        if len(kept) > MAX_POINTS:
            kept = np.sort(kept[np.argsort(weights[kept], kind="stable")[-MAX_POINTS:]])
        self.offsets, self.weights, self.ages, self.cut = points[kept], weights[kept], ages[kept], cut[kept]
        self.frames += 1

    def extend(self, other: Shape, offsets: Array) -> None:
        """Add the boundary points of another shape, at `offsets` (K, 2) in this body frame."""
        weights = np.concatenate([self.weights, other.weights])
        strongest = np.argsort(-weights, kind="stable")[:MAX_POINTS]
        self.offsets = np.concatenate([self.offsets, offsets])[strongest]
        self.weights, self.ages = weights[strongest], np.concatenate([self.ages, other.ages])[strongest]
        self.cut = np.concatenate([self.cut, other.cut])[strongest]

    @property
    def established(self) -> Mask:
        """The points (N,) with the age ESTABLISHED_FRAMES, or in a younger shape with the largest age."""
        return np.asarray(self.ages >= min(ESTABLISHED_FRAMES, self.ages.max()))

    @property
    def extent_m(self) -> float:
        """The longer side of the bounding box of the points in the body frame, metres."""
        return float(np.ptp(self.offsets, axis=0).max())


def to_body(points: Array, pose: Array) -> Array:
    """Points (N, 2), fixed frame, in the frame of a body at `pose` (3,), or of one body for each point (N, 3)."""
    (x, y), (cosine, sine) = (points - pose[..., :2]).T, (np.cos(pose[..., 2]), np.sin(pose[..., 2]))
    return np.stack([cosine * x + sine * y, cosine * y - sine * x], axis=1)


def to_grid(points: Array, pose: Array) -> Array:
    """The inverse of `to_body`."""
    (x, y), (cosine, sine) = points.T, (np.cos(pose[..., 2]), np.sin(pose[..., 2]))
    return np.asarray(pose[..., :2] + np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=1))


def rotation(angle: float) -> Array:
    """Rotation matrix (2, 2)."""
    cosine, sine = math.cos(angle), math.sin(angle)
    return np.array([[cosine, -sine], [sine, cosine]])


def in_view(boundaries: Sequence[Array], grid: GridSpec, visible: Mask) -> list[Mask]:
    """The points of each boundary (N, 2), metres, fixed frame, that lie in a visible cell; none outside the grid."""
    if not boundaries:
        return []
    cells, inside = grid.cells_of(np.concatenate(boundaries))
    seen = inside.copy()
    seen[inside] = visible[cells[inside, 0], cells[inside, 1]]
    return split(seen, boundaries)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _update(points, weights, cut, known, found, found_cut, revealed, in_view, apart_m, gain):  # type: ignore
    """Update the first `known` boundary points (N, 2), weights and whether cut off (N,) in place; see `Shape.update`.

    New points follow them. Returns the number of points.
    """
    total = known
    met = np.zeros(len(points), np.bool_)
    for k in range(len(found)):
        nearest, distance = -1, apart_m * apart_m
        for j in range(total):
            dx, dy = found[k, 0] - points[j, 0], found[k, 1] - points[j, 1]
            if dx * dx + dy * dy < distance:
                nearest, distance = j, dx * dx + dy * dy
        if nearest < 0:
            points[total, 0], points[total, 1] = found[k, 0], found[k, 1]
            weights[total] = REVEALED_WEIGHT if revealed[k] else 0.0
            met[total], cut[total] = True, found_cut[k]
            total += 1
        else:
            cut[nearest] = found_cut[k] and (cut[nearest] or not met[nearest])
            met[nearest] = True
    for j in range(total):
        if met[j]:
            weights[j] += gain * (1.0 - weights[j])
        else:
            weights[j] -= gain * weights[j] * (1.0 if in_view[j] else HIDDEN_DECAY)
    return total
