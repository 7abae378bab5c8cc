"""How the returns of a scan lie on the local map at a pose, and the step from there to a better pose.

The directions of the pose that the surroundings leave open are seen in the information of the distances across the
walls (Zhang, Kaess and Singh, ICRA 2016, "solution remapping"). One that a single compact cluster alone constrains is
open too: along a street the car in front is the only thing that seems to tell how far one has driven.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from gridtrack.common.geometry import SE2
from gridtrack.recordings.ego_motion.moving_returns import OBJECT_M
from gridtrack.recordings.ego_motion.returns import PlaneArray, ScanReturns
from gridtrack.recordings.ego_motion.settings import MatchingSettings

KERNEL_REACH = 3.0
"""Returns further from the map than this many kernels have no weight."""
COMPACT_M = 3.0
"""A cluster smaller than this, such as the rear of a car, constrains no direction alone."""


class Fit(NamedTuple):
    """How the returns of a scan lie on the map at a pose.

    `information` (3, 3) and `gradient` (3,) are those of the weighted distances across the walls, for x, y (metres) and
    heading in the sensor's frame, in units of one return; `of_compact` (C, 3, 3) is the part of each compact cluster,
    and `of_objects` (3, 3) that of all clusters of an object's size.
    `weight` is the sum of the weights, `lever_m` the root mean square distance of the returns from the sensor.
    """

    information: PlaneArray
    of_compact: PlaneArray
    of_objects: PlaneArray
    gradient: PlaneArray
    weight: float
    lever_m: float
    inliers: int
    residual_m: float


class Step(NamedTuple):
    """A step from a pose to a better one, in the frame of the pose.

    `information` (3, 3) of x, y and heading after it; `constrained`: whether the surroundings constrain the pose in
    every direction; `by_objects`: whether they do so in one direction by clusters of an object's size alone.
    """

    motion: SE2
    information: PlaneArray
    constrained: bool
    by_objects: bool


def fit_at(world_T_sensor: SE2, returns: ScanReturns, map_points: cKDTree, kernel_m: float) -> Fit:
    """The fit of `returns` at a pose to the nearest of `map_points`, (M, 2) in the world frame."""
    there = world_T_sensor.apply(returns.points)
    distance, nearest = map_points.query(there, distance_upper_bound=KERNEL_REACH * kernel_m)
    on_map = np.isfinite(distance) & returns.on_wall
    on_wall = returns.only(on_map)
    points, normals = on_wall.points, on_wall.normals
    apart = SE2(theta=-world_T_sensor.theta).apply(map_points.data[nearest[on_map]] - there[on_map])
    across = np.einsum("ni,ni->n", apart, normals)
    per_return = on_wall.length / max(float(returns.length.mean()), 1e-6) if len(returns.length) else on_wall.length
    weight = per_return * (kernel_m**2 / (kernel_m**2 + across**2)) ** 2
    lever = points[:, 0] * normals[:, 1] - points[:, 1] * normals[:, 0]
    jacobian = np.column_stack([normals, lever])
    return Fit(
        information=_information(jacobian, weight),
        of_compact=_of_compact(jacobian, weight, on_wall),
        of_objects=_information(jacobian, weight * (on_wall.extent < OBJECT_M)),
        gradient=jacobian.T @ (weight * across),
        weight=float(weight.sum()),
        lever_m=float(np.sqrt(np.mean(points**2) * 2.0)) if len(points) else 1.0,
        inliers=int(np.count_nonzero(distance <= kernel_m)),
        residual_m=float(np.median(np.abs(across))) if len(across) else 0.0,
    )


def _information(jacobian: PlaneArray, weight: PlaneArray) -> PlaneArray:
    """(3, 3) of distances with these derivatives (N, 3) and weights (N,)."""
    information: PlaneArray = (jacobian * weight[:, None]).T @ jacobian
    return information


def _of_compact(jacobian: PlaneArray, weight: PlaneArray, returns: ScanReturns) -> PlaneArray:
    """The information (C, 3, 3) of each compact cluster."""
    compact = returns.extent < COMPACT_M
    rows, weight = jacobian[compact], weight[compact]
    _, cluster = np.unique(returns.cluster[compact], return_inverse=True)
    products = (rows[:, :, None] * rows[:, None, :]).reshape(-1, 9) * weight[:, None]
    sums = np.zeros((len(np.unique(cluster)), 9))
    np.add.at(sums, cluster, products)
    return sums.reshape(-1, 3, 3)


def weighed_step(fit: Fit, fit_T_prior: SE2, prior: PlaneArray, settings: MatchingSettings) -> Step:
    """The step from the pose of `fit` to the best one.

    Along the eigenvectors of the information, heading scaled by the lever, that are open the step goes to the prior;
    elsewhere it is the weighted mean of the match and the prior (`prior` (3, 3) information).
    """
    scale = np.array([1.0, 1.0, max(fit.lever_m, 1e-3)])
    scaled = fit.information / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(scaled)
    of_compact = np.einsum("ik,cij,jk->ck", vectors, fit.of_compact / np.outer(scale, scale), vectors)
    without_one = values - of_compact.max(axis=0, initial=0.0)
    needed = settings.min_constraint * max(fit.weight, 1.0)
    strong = without_one >= needed
    of_objects = np.einsum("ik,ij,jk->k", vectors, fit.of_objects / np.outer(scale, scale), vectors)
    by_objects = bool((strong & (values - of_objects < needed)).any())
    kept = (vectors * strong) @ vectors.T
    noise = settings.return_noise_m**2
    information = (kept @ scaled @ kept) * np.outer(scale, scale) / noise + prior
    gradient = scale * (kept @ (fit.gradient / scale)) / noise
    towards = np.array([fit_T_prior.x, fit_T_prior.y, fit_T_prior.theta])
    step = np.linalg.solve(information, prior @ towards + gradient)
    return Step(SE2(*step.tolist()), information, bool(strong.all()), by_objects)
