"""Forecast: what a track is expected to show, its points moved by the mean motion and blurred by its uncertainty."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import GridSpec, Mask
from gridtrack.trackers.contract import TrackedObject
from gridtrack.trackers.model_free.dwell import staying
from gridtrack.trackers.model_free.rasterise import draw, draw_points, splat
from gridtrack.trackers.model_free.tracks import Status, Track

Array = NDArray[np.float64]


def appearance(
    track: Track, steps: int, grid: GridSpec, dwell: NDArray[np.float32], return_noise_m: float
) -> NDArray[np.float32]:
    """What the track's object, if it exists, shows at steps 0..steps: P(occupied) (steps+1, M, M) float32.

    Two alternatives for its returns. They are still where they were last seen, as the life table `dwell` expects of
    their age, blurred by `return_noise_m`. Or they have moved on with the object and look as its points have of late,
    blurred by the uncertainty of the predicted position.
    """
    image = np.zeros((steps + 1, *grid.shape), np.float32)
    still = np.ascontiguousarray(staying(dwell, track.ages, track.unseen, steps))  # one layout: compiled once
    draw_points(image, _in_cells(track.returns, grid), return_noise_m / grid.cell_m, still)
    means, covariances = track.estimator.ahead(steps)
    spread = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2)[:, :2]) / grid.cell_m
    patch = splat(track.shape.offsets, track.shape.weights, grid.cell_m)
    draw(image, patch, _in_cells(means[:, :2], grid), spread, 1.0 - still.mean(axis=0))
    return image


def share_in_view(image: NDArray[np.float32], track: Track, visible: Mask) -> float:
    """Which share of what the track shows at step 0, `image` (M, M), falls on visible cells (M, M).

    Outside the grid nothing is visible, so an object that may have left it is not missed there.
    """
    whole = max(float(image.sum()), float(track.shape.weights.sum()))
    return float(image[visible].sum()) / whole if whole > 0.0 else 0.0


def tracked_object(track: Track) -> TrackedObject:
    """The track as an object: its box along the direction of motion, about all that its points have shown of it."""
    mean = track.estimator.mean
    heading = float(np.arctan2(mean[3], mean[2]))
    along = np.array([np.cos(heading), np.sin(heading)])
    across = np.array([-along[1], along[0]])
    axes = np.stack([along, across])
    spans = track.shape.offsets @ axes.T
    low, high = spans.min(axis=0), spans.max(axis=0)
    centre = mean[:2] + (low + high) / 2.0 @ axes
    return TrackedObject(
        track=track.identity,
        box=np.array([*centre, heading, *(high - low)], np.float32),
        velocity=mean[2:].astype(np.float32),
        covariance=track.estimator.covariance.astype(np.float32),
    )


def objects(tracks: list[Track]) -> tuple[TrackedObject, ...]:
    """The confirmed tracks, seen now or coasting, as objects."""
    return tuple(tracked_object(track) for track in tracks if track.status is not Status.TENTATIVE)


def _in_cells(positions: Array, grid: GridSpec) -> Array:
    """Positions (N, 2) in metres as cells from the grid's lower-left corner."""
    return np.asarray((positions - np.array(grid.origin)) / grid.cell_m)
