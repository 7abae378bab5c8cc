"""Forecast: the expected occupancy of tracks, moved by their mean motion and blurred by its covariance; objects."""

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
from gridtrack.trackers.model_free.rasterise import Motions, Resident, Surfaces, draw_tracks
from gridtrack.trackers.model_free.residence import probability_in_place
from gridtrack.trackers.model_free.settings import PipelineSettings
from gridtrack.trackers.model_free.shape import in_view, rotation, to_body
from gridtrack.trackers.model_free.tracks import Status, Track, boundaries_of, poses_of
from gridtrack.trackers.model_free.window import Window

RETURN_PERSISTENCE = 0.9
"""P(a return that moves with its object is present in later frames)."""
HEADING_SPEED = 0.3
"""Speed, m/s, from which the direction of motion is the heading of an object."""


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

    `grid` has its corner in the fixed frame. The returns of a track are a mixture: they stay where they were last seen,
    with the probability that the life table `residence` gives for their age, reduced for a fast track; or they move
    with the object, in one of two regimes, blurred by the covariance of its position. The object survives each step
    with probability `survival`. The expected occupancy is also added to `semantics` (steps+1, K, M, M), multiplied by
    the `classes` (T, K) of the track.
    """
    if not tracks:
        return
    steps = np.arange(len(occupancy))
    resident = _resident(tracks, grid, residence, len(steps) - 1, settings)
    moved = 1.0 - means_of(resident.probability, resident.bounds)
    steady = np.array([track.estimator.probabilities[:1] for track in tracks]) * regimes.switching[0][0] ** steps
    poses, spreads = _motions(tracks, regimes, len(steps) - 1, grid)
    motions = Motions(poses, spreads, np.stack([moved * steady, moved * (1.0 - steady)], axis=1))
    existence = np.array([[track.existence] for track in tracks]) * survival**steps
    draw_tracks(occupancy, _surfaces(tracks, frame, grid), motions, resident, existence, semantics, classes)


def _motions(tracks: Sequence[Track], regimes: Regimes, steps: int, grid: GridSpec) -> tuple[Array, Array]:
    """Mean pose of each track in each regime (T, 2, steps+1, 3) and the covariance of its position, in cells.

    The present pose of a track that is seen now is taken as exact: its returns are known, only its motion is uncertain.
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
    """The surface of each track: its newest returns and the hidden part of its boundary, or, unobserved, all of it."""
    returns, boundaries = [track.returns for track in tracks], boundaries_of(tracks)
    seen, poses = np.array([not track.unseen for track in tracks]), poses_of(tracks)
    return_owners, boundary_owners = owners_of(bounds_of(returns)), owners_of(bounds_of(boundaries))
    observed = seen[return_owners]
    hidden = ~(seen[boundary_owners] & np.concatenate(in_view(boundaries, grid, frame.visible)))
    shapes = [track.shape for track in tracks]
    points = (
        to_body(np.concatenate(returns)[observed], poses[return_owners[observed]]),
        np.concatenate([shape.offsets for shape in shapes])[hidden],
    )
    weights = np.full(len(points[0]), RETURN_PERSISTENCE), np.concatenate([shape.weights for shape in shapes])[hidden]
    owners = np.concatenate([return_owners[observed], boundary_owners[hidden]])
    order = np.argsort(owners, kind="stable")
    bounds = np.searchsorted(owners[order], np.arange(len(tracks) + 1))
    return Surfaces(np.concatenate(points)[order] / grid.cell_m, np.concatenate(weights)[order], bounds)


def _resident(
    tracks: Sequence[Track], grid: GridSpec, residence: NDArray[np.float32], steps: int, settings: PipelineSettings
) -> Resident:
    """The newest returns of the tracks, with the probability that they stay in place, reduced by the track's speed."""
    returns = [track.returns for track in tracks]
    bounds = bounds_of(returns)
    owners = owners_of(bounds)
    velocities = np.array([track.estimator.mean[3:5] for track in tracks])
    slow = np.exp(-(velocities**2).sum(axis=1) / settings.residence_speed**2).astype(np.float32)
    unseen = np.array([track.unseen for track in tracks])
    probability = probability_in_place(
        residence, np.concatenate([track.ages for track in tracks]), unseen[owners], steps
    )
    probability *= slow[owners, None]
    return Resident(in_cells(np.concatenate(returns), grid), bounds, probability, settings.return_noise_m / grid.cell_m)


def tracked_object(track: Track, window: Window) -> TrackedObject:
    """The track as an object: the box of its boundary along its heading, enlarged by one cell."""
    mean, covariance = track.estimator.mean, track.estimator.covariance
    boundary = track.boundary
    heading = _heading(mean[3:5], boundary)
    axes = rotation(heading).T
    spans = boundary @ axes.T
    low, high = spans.min(axis=0), spans.max(axis=0)
    centre = (low + high) / 2.0 @ axes - window.offset_m
    kept = np.ix_([0, 1, 3, 4], [0, 1, 3, 4])
    return TrackedObject(
        track=track.identity,
        box=np.array([*centre, heading, *(high - low + window.grid.cell_m)], np.float32),
        velocity=mean[3:5].astype(np.float32),
        covariance=covariance[kept].astype(np.float32),
    )


def objects(tracks: Sequence[Track], window: Window) -> tuple[TrackedObject, ...]:
    """The confirmed and the coasting tracks as objects, in the grid frame of the `window`."""
    return tuple(tracked_object(track, window) for track in tracks if track.status is not Status.TENTATIVE)


def in_cells(positions: Array, grid: GridSpec) -> Array:
    """Positions (..., 2), metres, in cells from the lower-left corner of the grid."""
    return np.asarray((positions - np.array(grid.origin)) / grid.cell_m)


def _heading(velocity: Array, boundary: Array) -> float:
    """The direction of motion; of a slow object the longer axis of its boundary (N, 2)."""
    if np.hypot(*velocity) >= HEADING_SPEED or len(boundary) < 2:
        return float(np.arctan2(velocity[1], velocity[0]))
    along = np.linalg.svd(boundary - boundary.mean(axis=0), full_matrices=False)[2][0]
    return float(np.arctan2(along[1], along[0]))
