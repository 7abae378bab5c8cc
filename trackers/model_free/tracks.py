"""Tracks: their state, shape and existence; tentative until their detections confirm them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import GridSpec, Shift
from gridtrack.trackers.model_free.arrays import Array, bounds_of, owners_of, split
from gridtrack.trackers.model_free.estimators import SwitchingEstimator
from gridtrack.trackers.model_free.shape import Shape, to_grid

NOT_PLACED = np.empty(0), np.empty(0), np.empty((0, 2))
"""The cached boundary before it is computed."""


class Window:
    """The pose of the grid in the fixed frame, which is the grid frame of the first update.

    The fixed frame has the axes of the world and an origin near the sensor, so that coordinates are small. `shift` is
    the motion of the window since the first update, in whole cells; `fixed_grid` is the grid with its corner in the
    fixed frame; `offset_m` (2,) leads from the grid frame to the fixed frame.
    """

    __slots__ = ("fixed_grid", "grid", "offset_m", "shift")

    def __init__(self, grid: GridSpec, shift: Shift = Shift()) -> None:  # noqa: B008 (immutable)
        self.grid, self.shift = grid, shift
        self.offset_m: Array = np.array([shift.columns, shift.rows]) * grid.cell_m
        x, y = (np.array(grid.origin) + self.offset_m).tolist()
        self.fixed_grid = GridSpec(grid.size, grid.cell_m, (x, y)) if shift else grid

    def moved(self, by: Shift) -> Window:
        """The window after a further shift."""
        return Window(self.grid, Shift(self.shift.rows + by.rows, self.shift.columns + by.columns))


@dataclass(slots=True, eq=False)
class Track:
    """One object followed over time; `existence` is the probability that there is an object."""

    identity: int
    estimator: SwitchingEstimator
    shape: Shape
    returns: Array
    """Its newest returns (N, 2), metres, fixed frame, observed `unseen` periods ago."""
    ages: NDArray[np.int64]
    """The number of periods for which each return (N,) had been in place at that time."""
    existence: float
    confirmed: bool = False
    """False of a tentative track; a confirmed track that is unseen is coasting."""
    unseen: int = 0
    """Periods since returns were last assigned to it."""
    stopped: int = 0
    """Consecutive periods in which its velocity did not differ significantly from zero."""
    previous_pose: Array = field(init=False)
    """Its pose (3,) at the previous frame."""
    _placed: tuple[Array, Array, Array] = NOT_PLACED
    """Cache: the state and the offsets for which the boundary was computed, and the boundary."""

    @property
    def pose(self) -> Array:
        """Pose (3,): x, y, heading; metres, radians, fixed frame."""
        return np.asarray(self.estimator.mean[:3])

    @property
    def boundary(self) -> Array:
        """Its boundary points (N, 2), metres, fixed frame."""
        return boundaries_of([self])[0]


def poses_of(tracks: Sequence[Track]) -> Array:
    """The poses (T, 3): x, y, heading; metres, radians, fixed frame."""
    return np.array([track.pose for track in tracks])


def boundaries_of(tracks: Sequence[Track]) -> list[Array]:
    """The boundary points (N, 2) of each track, metres, fixed frame; cached until its pose or shape changes."""
    moved = [
        track
        for track in tracks
        if track._placed[0] is not track.estimator.mean or track._placed[1] is not track.shape.offsets
    ]
    if moved:
        offsets = [track.shape.offsets for track in moved]
        poses = poses_of(moved)[owners_of(bounds_of(offsets))]
        for track, points in zip(moved, split(to_grid(np.concatenate(offsets), poses), offsets), strict=True):
            track._placed = track.estimator.mean, track.shape.offsets, points
    return [track._placed[2] for track in tracks]


def existence_when_detected(existence: float, detection_probability: float, clutter_probability: float) -> float:
    """Bayes' rule for the existence probability after a detection in the gate (Musicki and Evans 1994)."""
    hit = existence * detection_probability
    return hit / (hit + (1.0 - existence) * clutter_probability)


def existence_when_missed(existence: float, detection_probability: float) -> float:
    """Bayes' rule for the existence probability after a missed detection.

    `detection_probability`: of an existing object; 0 for a hidden one, because its miss is no evidence.
    """
    return existence * (1.0 - detection_probability) / (1.0 - existence * detection_probability)
