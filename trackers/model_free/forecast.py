"""Forecast: what tracks are expected to show: boundaries moved by the mean motion, blurred by its covariance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.trackers.contract import TrackedObject
from gridtrack.trackers.model_free.arrays import Array
from gridtrack.trackers.model_free.motion.model import propagate
from gridtrack.trackers.model_free.motion.parameters import Regimes
from gridtrack.trackers.model_free.ragged import bounds_of, means_of, owners_of
from gridtrack.trackers.model_free.rasterise import Motions, Staying, Surfaces, draw_tracks
from gridtrack.trackers.model_free.residence import still_there
from gridtrack.trackers.model_free.settings import PipelineSettings
from gridtrack.trackers.model_free.shape import in_view, rotation, to_body
from gridtrack.trackers.model_free.tracks import Status, Track, boundaries_of, poses_of

RETURNS_AGAIN = 0.9
"""P(a return of an object that moves on with it is there in the frames after)."""
OBSERVABLE_SPEED = 0.3
"""Below this speed, m/s, an object's direction of motion is not its heading."""


def add_tracks(
    occupancy: NDArray[np.float32],
    tracks: Sequence[Track],
    survival: float,
    regimes: Regimes,
    frame: GridFrame,
    grid: GridSpec,
    residence: NDArray[np.float32],
    settings: PipelineSettings,
    semantics: NDArray[np.float32],
    classes: NDArray[np.float32],
) -> None:
    """Combine the expected occupancy of each track into `occupancy` (steps+1, M, M) float32, at steps 0..steps.

    The returns of a track are a mixture: they stay where they were last seen, with the probability that the life table
    `residence` gives for their age, reduced for a fast track; or they move with the object, in one of two regimes,
    blurred by the covariance of its position. The object survives each step with probability `survival`. The expected
    occupancy is also added to `semantics` (steps+1, K, M, M), multiplied by the `classes` (T, K) of the track.
    """
    if not tracks:
        return
    steps = np.arange(len(occupancy))
    staying = _staying(tracks, grid, residence, len(steps) - 1, settings)
    moved = 1.0 - means_of(staying.still, staying.bounds)
    steadily = np.array([track.estimator.probabilities[:1] for track in tracks]) * regimes.switching[0][0] ** steps
    poses, spreads = _motions(tracks, regimes, len(steps) - 1, grid)
    motions = Motions(poses, spreads, np.stack([moved * steadily, moved * (1.0 - steadily)], axis=1))
    existence = np.array([[track.existence] for track in tracks]) * survival**steps
    draw_tracks(occupancy, _surfaces(tracks, frame, grid), motions, staying, existence, semantics, classes)


def _motions(tracks: Sequence[Track], regimes: Regimes, steps: int, grid: GridSpec) -> tuple[Array, Array]:
    """Each track's mean pose in each regime (T, 2, steps+1, 3) and the covariance of its position, in cells.

    Where a track is seen now, its returns are where they are: what is uncertain of their future is the motion alone.
    """
    poses, spreads = [], []
    seen = np.array([not track.unseen for track in tracks])
    now = poses_of(tracks)
    for regime, model in enumerate(regimes.models):
        estimators = [track.estimator.estimators[regime] for track in tracks]
        means = np.array([estimator.mean for estimator in estimators])
        covariances = np.array([estimator.covariance for estimator in estimators])
        means[seen, :3] = now[seen]
        covariances[seen, :3] = covariances[seen, :, :3] = 0.0
        means, covariances = propagate(means, covariances, steps, model)
        poses.append(np.concatenate([in_cells(means[..., :2], grid), means[..., 2:3]], axis=2))
        spreads.append(covariances[..., :2, :2] / grid.cell_m**2)
    return np.stack(poses, axis=1), np.stack(spreads, axis=1)


def _surfaces(tracks: Sequence[Track], frame: GridFrame, grid: GridSpec) -> Surfaces:
    """What each track's object shows.

    Of what is seen now its newest returns, and of its boundary what is hidden now; of what is not, all of its boundary.
    """
    returns, boundaries = [track.returns for track in tracks], boundaries_of(tracks)
    seen, poses = np.array([not track.unseen for track in tracks]), poses_of(tracks)
    returned, bounding = owners_of(bounds_of(returns)), owners_of(bounds_of(boundaries))
    again = seen[returned]
    hidden = ~(seen[bounding] & np.concatenate(in_view(boundaries, grid, frame.visible)))
    shapes = [track.shape for track in tracks]
    points = (
        to_body(np.concatenate(returns)[again], poses[returned[again]]),
        np.concatenate([shape.offsets for shape in shapes])[hidden],
    )
    weights = np.full(len(points[0]), RETURNS_AGAIN), np.concatenate([shape.weights for shape in shapes])[hidden]
    owners = np.concatenate([returned[again], bounding[hidden]])
    order = np.argsort(owners, kind="stable")
    bounds = np.searchsorted(owners[order], np.arange(len(tracks) + 1))
    return Surfaces(np.concatenate(points)[order] / grid.cell_m, np.concatenate(weights)[order], bounds)


def _staying(
    tracks: Sequence[Track], grid: GridSpec, residence: NDArray[np.float32], steps: int, settings: PipelineSettings
) -> Staying:
    """The tracks' newest returns where they were seen: each still there by its age, and less if its track is fast."""
    returns = [track.returns for track in tracks]
    bounds = bounds_of(returns)
    owners = owners_of(bounds)
    velocities = np.array([track.estimator.mean[3:5] for track in tracks])
    slow = np.exp(-(velocities**2).sum(axis=1) / settings.residence_speed**2).astype(np.float32)
    unseen = np.array([track.unseen for track in tracks])
    still = still_there(residence, np.concatenate([track.ages for track in tracks]), unseen[owners], steps)
    still *= slow[owners, None]
    return Staying(in_cells(np.concatenate(returns), grid), bounds, still, settings.return_noise_m / grid.cell_m)


def tracked_object(track: Track, cell_m: float) -> TrackedObject:
    """The track as an object: its box about its boundary, along the motion or, where it stands, along itself.

    A boundary point stands for as much as a cell, `cell_m`.
    """
    mean, covariance = track.estimator.mean, track.estimator.covariance
    boundary = track.boundary
    heading = _heading(mean[3:5], boundary)
    axes = rotation(heading).T
    spans = boundary @ axes.T
    low, high = spans.min(axis=0), spans.max(axis=0)
    centre = (low + high) / 2.0 @ axes
    kept = np.ix_([0, 1, 3, 4], [0, 1, 3, 4])
    return TrackedObject(
        track=track.identity,
        box=np.array([*centre, heading, *(high - low + cell_m)], np.float32),
        velocity=mean[3:5].astype(np.float32),
        covariance=covariance[kept].astype(np.float32),
    )


def objects(tracks: Sequence[Track], cell_m: float) -> tuple[TrackedObject, ...]:
    """The confirmed tracks, seen now or coasting, as objects."""
    return tuple(tracked_object(track, cell_m) for track in tracks if track.status is not Status.TENTATIVE)


def in_cells(positions: Array, grid: GridSpec) -> Array:
    """Positions (..., 2) in metres as cells from the grid's lower-left corner."""
    return np.asarray((positions - np.array(grid.origin)) / grid.cell_m)


def _heading(velocity: Array, boundary: Array) -> float:
    """The direction of motion, or of what stands the longer axis of its boundary (N, 2)."""
    if np.hypot(*velocity) >= OBSERVABLE_SPEED or len(boundary) < 2:
        return float(np.arctan2(velocity[1], velocity[0]))
    along = np.linalg.svd(boundary - boundary.mean(axis=0), full_matrices=False)[2][0]
    return float(np.arctan2(along[1], along[0]))
