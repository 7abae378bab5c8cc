"""Point-to-line fit of a scan to the local map at a pose, and the step to a better pose."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gridtrack.common.geometry import SE2
from gridtrack.recordings.ego_motion.returns import OBJECT_M, PlaneArray, ScanReturns

KERNEL_M = 0.1
"""Scale of the robust kernel: the weight is a quarter at this distance from the map, and 0 at three times it."""
RETURN_NOISE_M = 0.02
"""Standard deviation of the distance of a return to its wall, which weighs the match against the prior."""
MIN_RETURNS, MIN_INLIER_SHARE = 20, 0.4
"""Minimum number of returns in range for a match, and minimum share of them on the map."""
MIN_CONSTRAINT = 0.01
"""Minimum share of the surface that must constrain a direction; else the prior decides it. The compact cluster that
constrains the direction most does not count: it may move."""
KERNEL_REACH = 3.0
"""Returns further from the map than this many kernel scales have no weight."""
MAX_STEPS, SMALL_STEP = 10, 1e-3
"""Limit of the steps of `stepped`, and the size of the last one (metres plus radians)."""
COMPACT_M = 3.0
"""Clusters smaller than this, such as the rear of a car, are compact: one alone constrains no direction."""


class Walls(NamedTuple):
    """The N returns of a scan on walls, with all values that do not depend on the pose.

    `points` and `normals` (N, 2), sensor frame. `jacobian` (N, 3): derivatives of the distances across the walls by
    x, y (metres) and heading, sensor frame. `share` (N,): the surface of a return over the mean of the scan.
    `of_object` (N,): in a cluster of an object's size. `compact` (N,): in a compact cluster; these K returns have
    `products` (K, 9) of the derivatives, and their C clusters begin at `begins` (C,).
    """

    points: PlaneArray
    normals: PlaneArray
    jacobian: PlaneArray
    share: PlaneArray
    of_object: NDArray[np.bool_]
    compact: NDArray[np.bool_]
    products: PlaneArray
    begins: NDArray[np.int64]


class Fit(NamedTuple):
    """The fit of the walls of a scan to the map at a pose: distances `across` the walls (N,), and their `weight` (N,).

    A return that is not `on_map` (N,) has the weight 0. `information` (3, 3) and `gradient` (3,) are of the weighted
    distances, in units of one return; `of_compact` (C, 3, 3) is the part of each compact cluster. `lever_m` is the root
    mean square distance of the walls on the map from the sensor.
    """

    across: PlaneArray
    weight: PlaneArray
    on_map: NDArray[np.bool_]
    information: PlaneArray
    of_compact: PlaneArray
    gradient: PlaneArray
    lever_m: float

    @property
    def residual_m(self) -> float:
        """The median distance across the walls that are on the map."""
        return float(np.median(np.abs(self.across[self.on_map]))) if self.on_map.any() else 0.0


class Step(NamedTuple):
    """A step from a pose to a better one, in the frame of the pose.

    `information` (3, 3) of x, y and heading afterwards; `constrained`: the surroundings constrain every direction.
    """

    motion: SE2
    information: PlaneArray
    constrained: bool


class _Directions(NamedTuple):
    """The eigenvectors and eigenvalues of the information, with the heading scaled by the lever (`scale`).

    A direction is `strong` if its eigenvalue, without the compact cluster that constrains it most, is at least
    `needed`.
    """

    scale: PlaneArray
    scaled: PlaneArray
    values: PlaneArray
    vectors: PlaneArray
    needed: float
    strong: NDArray[np.bool_]


def walls_of(returns: ScanReturns) -> Walls:
    """The returns of a scan on walls, for `fit_at`."""
    on_wall = returns.only(returns.on_wall)
    points, normals = on_wall.points, on_wall.normals
    jacobian = np.column_stack([normals, points[:, 0] * normals[:, 1] - points[:, 1] * normals[:, 0]])
    mean_m = max(float(returns.length.mean()), 1e-6) if len(returns.length) else 1.0
    compact = on_wall.extent < COMPACT_M
    rows, cluster = jacobian[compact], on_wall.cluster[compact]
    return Walls(
        points=points,
        normals=normals,
        jacobian=jacobian,
        share=on_wall.length / mean_m,
        of_object=on_wall.extent < OBJECT_M,
        compact=compact,
        products=(rows[:, :, None] * rows[:, None, :]).reshape(-1, 9),
        begins=np.flatnonzero(np.diff(cluster, prepend=-1)),
    )


def fit_at(world_T_sensor: SE2, walls: Walls, map_points: cKDTree, kernel_m: float) -> Fit:
    """The fit of `walls` at a pose to the nearest of `map_points`, (M, 2), world frame."""
    there = world_T_sensor.apply(walls.points)
    distance, nearest = map_points.query(there, distance_upper_bound=KERNEL_REACH * kernel_m)
    on_map = np.isfinite(distance)
    apart = SE2(theta=-world_T_sensor.theta).apply(map_points.data[np.where(on_map, nearest, 0)] - there)
    across = (apart * walls.normals).sum(axis=1)
    weight = np.where(on_map, walls.share * (kernel_m**2 / (kernel_m**2 + across**2)) ** 2, 0.0)
    squares = np.square(walls.points[on_map])
    return Fit(
        across=across,
        weight=weight,
        on_map=on_map,
        information=_information(walls.jacobian, weight),
        of_compact=_of_compact(walls, weight),
        gradient=walls.jacobian.T @ (weight * across),
        lever_m=float(np.sqrt(squares.mean() * 2.0)) if len(squares) else 1.0,
    )


def share_on_map(world_T_sensor: SE2, returns: ScanReturns, map_points: cKDTree, kernel_m: float, count: int) -> float:
    """The number of returns within `kernel_m` of the map at a pose, over `count`."""
    distance, _ = map_points.query(world_T_sensor.apply(returns.points), distance_upper_bound=kernel_m)
    return float(np.count_nonzero(np.isfinite(distance)) / count)


def _information(jacobian: PlaneArray, weight: PlaneArray) -> PlaneArray:
    """The information (3, 3) of distances with these derivatives (N, 3) and weights (N,)."""
    information: PlaneArray = (jacobian * weight[:, None]).T @ jacobian
    return information


def _of_compact(walls: Walls, weight: PlaneArray) -> PlaneArray:
    """The information (C, 3, 3) of each compact cluster; the returns of a cluster are consecutive."""
    if not len(walls.begins):
        return np.zeros((0, 3, 3))
    sums: PlaneArray = np.add.reduceat(walls.products * weight[walls.compact, None], walls.begins)
    return sums.reshape(-1, 3, 3)


def weighed_step(fit: Fit, fit_T_prior: SE2, prior: PlaneArray) -> Step:
    """The step from the pose of `fit` to the best one; `prior` (3, 3) is the information of the prior.

    In weak directions the step leads to the prior, in strong ones to the weighted mean of match and prior.
    """
    scale, scaled, _, vectors, _, strong = _directions(fit)
    kept = (vectors * strong) @ vectors.T
    noise = RETURN_NOISE_M**2
    information = (kept @ scaled @ kept) * np.outer(scale, scale) / noise + prior
    gradient = scale * (kept @ (fit.gradient / scale)) / noise
    towards = np.array([fit_T_prior.x, fit_T_prior.y, fit_T_prior.theta])
    step = np.linalg.solve(information, prior @ towards + gradient)
    return Step(SE2(*step.tolist()), information, bool(strong.all()))


def stepped(pose: SE2, walls: Walls, map_points: cKDTree, prior: tuple[SE2, PlaneArray], kernel_m: float) -> SE2:
    """The pose at which `walls` lie on the map, from a `pose` nearby; the `prior` (pose, information) decides weak
    directions."""
    expected, information = prior
    for _ in range(MAX_STEPS):
        fit = fit_at(pose, walls, map_points, kernel_m)
        motion = weighed_step(fit, pose.inverse() @ expected, information).motion
        pose = pose @ motion
        if math.hypot(motion.x, motion.y) + abs(motion.theta) < SMALL_STEP:
            break
    return pose


def by_objects(fit: Fit, walls: Walls) -> bool:
    """Whether clusters of an object's size alone constrain a direction of `fit`."""
    scale, _, values, vectors, needed, strong = _directions(fit)
    of_objects = _information(walls.jacobian, fit.weight * walls.of_object) / np.outer(scale, scale)
    return bool((strong & (values - _along(vectors, of_objects) < needed)).any())


def _directions(fit: Fit) -> _Directions:
    scale = np.array([1.0, 1.0, max(fit.lever_m, 1e-3)])
    scaled = fit.information / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(scaled)
    of_compact = _along(vectors, fit.of_compact / np.outer(scale, scale))
    needed = MIN_CONSTRAINT * max(float(fit.weight.sum()), 1.0)
    strong = values - of_compact.max(axis=0, initial=0.0) >= needed
    return _Directions(scale, scaled, values, vectors, needed, strong)


def _along(vectors: PlaneArray, information: PlaneArray) -> PlaneArray:
    """Information (..., 3, 3) along each column of `vectors` (3, 3): (..., 3)."""
    along: PlaneArray = ((information @ vectors) * vectors).sum(axis=-2)
    return along
