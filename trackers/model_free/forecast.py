"""Forecast of the tracks: expected occupancy, classes and velocities of the cells at each step, and objects."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import GridFrame, GridSpec, Mask
from gridtrack.trackers.contract import TrackedObject
from gridtrack.trackers.model_free.arrays import Array, bounds_of, means_of, owners_of
from gridtrack.trackers.model_free.motion import MotionModel, Regimes, propagate
from gridtrack.trackers.model_free.rasterise import Motions, Resident, Surfaces, draw_tracks
from gridtrack.trackers.model_free.residence import probability_in_place
from gridtrack.trackers.model_free.settings import PipelineSettings
from gridtrack.trackers.model_free.shape import in_view, rotation, to_body
from gridtrack.trackers.model_free.tracks import Track, Window, boundaries_of, poses_of

RETURN_PERSISTENCE = 0.9
"""P(a return that moves with its object is present in later frames)."""
HEADING_SPEED = 0.3
"""Speed, m/s, from which the direction of motion is the heading of an object."""


Planes = NDArray[np.float32]
MIN_PRIOR_WEIGHT = 1e-6
"""Smallest weight of the prior in a cell: a cell without a track has the classes of the prior."""
FLOW_REACH_SIGMAS = 2.0
"""A cell has the velocity of a track within a cell and this many standard deviations of the track's position."""


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

    `grid` has its corner in the fixed frame. The returns of a track are a mixture. They stay where they were last seen:
    the life table `residence` gives the probability for their age, which is lower for a fast track. Or they move with
    the object, in one of two regimes, blurred by the covariance of its position. The object survives each step with
    probability `survival`. The expected occupancy is also added to `semantics` (steps+1, K, M, M), multiplied by the
    `classes` (T, K) of the track.
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

    The present pose of a visible track counts as exact: its returns are known, only its motion is uncertain.
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
    """The surface of each track: its newest returns and the hidden part of its boundary; if unseen, all of it."""
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
    return tuple(tracked_object(track, window) for track in tracks if track.confirmed)


def in_cells(positions: Array, grid: GridSpec) -> Array:
    """Positions (..., 2), metres, in cells from the lower-left corner of the grid."""
    return np.asarray((positions - np.array(grid.origin)) / grid.cell_m)


def _heading(velocity: Array, boundary: Array) -> float:
    """The direction of motion; for a slow object the longer axis of its boundary (N, 2)."""
    if np.hypot(*velocity) >= HEADING_SPEED or len(boundary) < 2:
        return float(np.arctan2(velocity[1], velocity[0]))
    along = np.linalg.svd(boundary - boundary.mean(axis=0), full_matrices=False)[2][0]
    return float(np.arctan2(along[1], along[0]))


def weight_by_cell_prior(occupancy: Planes, cell_prior: Planes) -> Planes:
    """Semantics (steps+1, K, M, M), not normalised: the background occupancy times the `cell_prior` (K, M, M)."""
    semantics = np.empty((len(occupancy), *cell_prior.shape), np.float32)
    _weight_by_cell_prior(semantics, occupancy, cell_prior)
    return semantics


def attribute(
    semantics: Planes, cell_prior: Planes, occupied: Mask, tracks: Sequence[Track], classes: Planes, grid: GridSpec
) -> None:
    """Set the classes of the `occupied` cells (M, M) of the observed frame in its `semantics` (K, M, M).

    The returns of a track have its `classes` (T, K); other returns have the classes of `cell_prior`.
    """
    semantics[:, occupied] = cell_prior[:, occupied]
    seen = [number for number, track in enumerate(tracks) if not track.unseen]
    if seen:
        cells, inside = grid.cells_of(np.concatenate([tracks[number].returns for number in seen]))
        owner = np.repeat(seen, [len(tracks[number].returns) for number in seen])[inside]
        semantics[:, cells[inside, 0], cells[inside, 1]] = classes[owner].T


def normalise(semantics: Planes) -> None:
    """Scale the classes of each cell (steps+1, K, M, M) to sum 1, in place; each sum must be positive."""
    steps, classes, rows, columns = semantics.shape
    _normalise(semantics.reshape(steps, classes, rows * columns))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _weight_by_cell_prior(semantics, occupancy, cell_prior):  # type: ignore[no-untyped-def]
    steps, classes, size, _ = semantics.shape
    for step in range(steps):
        for k in range(classes):
            for row in range(size):
                into, shown, share = semantics[step, k, row], occupancy[step, row], cell_prior[k, row]
                for column in range(size):
                    into[column] = max(shown[column], np.float32(MIN_PRIOR_WEIGHT)) * share[column]


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def _normalise(semantics):  # type: ignore[no-untyped-def]
    steps, classes, cells = semantics.shape
    if not classes:
        return
    total = np.empty(cells, np.float32)
    for step in range(steps):
        total[:] = 0.0
        for k in range(classes):
            for cell in range(cells):
                total[cell] += semantics[step, k, cell]
        for cell in range(cells):
            total[cell] = np.float32(1.0) / total[cell]
        for k in range(classes):
            for cell in range(cells):
                semantics[step, k, cell] *= total[cell]


def flow_of(tracks: Sequence[Track], steps: int, model: MotionModel, grid: GridSpec) -> NDArray[np.float16]:
    """Velocities (steps+1, 2, M, M), m/s, at steps 0..steps; NaN in cells that no confirmed or coasting track reaches.

    `grid` has its corner in the fixed frame. At each step a cell belongs to the track with the nearest bounding box.
    Its velocity is the one of this rigid body at the cell's centre, predicted with the motion `model`.
    """
    kept = [track for track in tracks if track.confirmed]
    flow = np.full((steps + 1, 2, *grid.shape), np.nan, np.float32)
    if kept:
        means, covariances = propagate(
            np.array([track.estimator.mean for track in kept]),
            np.array([track.estimator.covariance for track in kept]),
            steps,
            model,
        )
        boxes = np.array([(*track.shape.offsets.min(axis=0), *track.shape.offsets.max(axis=0)) for track in kept])
        variances = np.trace(covariances[..., :2, :2], axis1=2, axis2=3) / 2.0
        reach_m = grid.cell_m + FLOW_REACH_SIGMAS * np.sqrt(variances)
        draw_flow(flow, boxes, means, reach_m, np.array(grid.origin), grid.cell_m)
    return flow.astype(np.float16)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def draw_flow(flow, boxes, means, reach_m, corner, cell_m):  # type: ignore[no-untyped-def]
    """Draw T bodies with `boxes` (T, 4) in their frames, states `means` (T, n+1, 6), into `flow` (n+1, 2, M, M)."""
    size = flow.shape[2]
    for n in range(flow.shape[0]):
        nearest = np.full((size, size), np.inf)
        for t in range(len(boxes)):
            left, bottom, right, top = boxes[t, 0], boxes[t, 1], boxes[t, 2], boxes[t, 3]
            x, y, heading, vx, vy, turn_rate = means[t, n]
            cos, sin, reach = math.cos(heading), math.sin(heading), reach_m[t, n]
            radius = reach + math.hypot(max(abs(left), abs(right)), max(abs(bottom), abs(top)))
            rows, columns = _covered(y - corner[1], radius, cell_m, size), _covered(x - corner[0], radius, cell_m, size)
            for row in range(rows[0], rows[1]):
                dy = corner[1] + (row + 0.5) * cell_m - y
                for column in range(columns[0], columns[1]):
                    dx = corner[0] + (column + 0.5) * cell_m - x
                    ahead, aside = cos * dx + sin * dy, cos * dy - sin * dx
                    out_x, out_y = max(left - ahead, 0.0, ahead - right), max(bottom - aside, 0.0, aside - top)
                    squared = out_x * out_x + out_y * out_y
                    if squared <= reach * reach and squared < nearest[row, column]:
                        nearest[row, column] = squared
                        flow[n, 0, row, column] = vx - turn_rate * dy
                        flow[n, 1, row, column] = vy + turn_rate * dx


@numba.njit(error_model="numpy")
def _covered(centre_m, radius_m, cell_m, size):  # type: ignore[no-untyped-def]
    """Range (first, last + 1) of the cells within a radius of a centre, of `size` cells along an axis."""
    first, last = (centre_m - radius_m) / cell_m, (centre_m + radius_m) / cell_m
    return int(min(max(first, 0.0), size)), int(min(max(last + 1.0, 0.0), size))


def compile_flow() -> None:
    """Compile the kernel, by running it without tracks."""
    none: Array = np.zeros((0, 4))
    draw_flow(np.zeros((1, 2, 1, 1), np.float32), none, np.zeros((0, 1, 6)), np.zeros((0, 1)), np.zeros(2), 1.0)
