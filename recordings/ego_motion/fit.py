"""How the returns of a scan lie on the local map at a pose, and the step to a better pose."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.spatial import cKDTree

from gridtrack.common.config import Settings
from gridtrack.common.geometry import SE2
from gridtrack.recordings.ego_motion.returns import OBJECT_M, PlaneArray, ScanReturns


class MatchingSettings(Settings):
    """How scans are matched with the local map, and when a match is not used. Metres, radians, seconds."""

    max_range_m: float = Field(default=20.0, gt=0.0, le=1e3)
    """Returns beyond it are not matched, and the map is forgotten beyond it."""
    voxel_m: float = Field(default=0.3, gt=0.0, le=10.0)
    """Side of the voxels of the local map."""
    point_spacing_m: float = Field(default=0.1, gt=0.0, le=10.0)
    """Returns nearer to one another than this are registered as one."""
    map_spacing_m: float = Field(default=0.03, gt=0.0, le=10.0)
    """The same of the returns that are added to the map."""
    kernel_m: float = Field(default=0.1, gt=0.0, le=10.0)
    """Scale of the robust kernel: a return this far from the map has a quarter of the weight, at three times none."""
    coarse_kernel_m: float = Field(default=0.5, gt=0.0, le=10.0)
    """Kernel of the registration where there is no odometry."""
    return_noise_m: float = Field(default=0.02, gt=0.0, le=10.0)
    """Standard deviation of one return's distance to its wall, which weighs the match against the prior."""
    odometry_drift: float = Field(default=0.05, ge=0.0, le=10.0)
    """Standard deviation of odometry's position, metres for each metre driven."""
    odometry_turn_drift: float = Field(default=1.0, ge=0.0, le=10.0)
    """Standard deviation of odometry's heading, radians for each radian turned, and half of it for each metre."""
    acceleration: float = Field(default=3.0, ge=0.0, le=100.0)
    """Without odometry: m/s^2, standard deviation of the change of the velocity."""
    turn_acceleration: float = Field(default=10.0, ge=0.0, le=1e3)
    """Without odometry: rad/s^2, as above."""
    min_returns: int = Field(default=20, ge=3)
    """A scan with fewer returns in range is not matched."""
    min_inlier_share: float = Field(default=0.4, ge=0.0, le=1.0)
    """Share of the returns that must lie on the map."""
    min_constraint: float = Field(default=0.01, ge=0.0, le=0.5)
    """A direction is left to the prior in which less than this share of the surface constrains the pose, the compact
    cluster left out that constrains it most: it may move."""
    max_deviations: float = Field(default=5.0, gt=0.0)
    """A match is not used that is further from the prior than so many of its deviations, and 20 cm or 15 deg."""


KERNEL_REACH = 3.0
"""Returns further from the map than this many kernels have no weight."""
MAX_STEPS, SMALL_STEP = 10, 1e-3
"""Steps on the walls, until one is smaller than this: metres and radians together."""
COMPACT_M = 3.0
"""A cluster smaller than this, such as the rear of a car, constrains no direction alone."""


class Walls(NamedTuple):
    """The N returns of a scan that lie on walls, with all that does not depend on the pose at which they are fitted.

    `points` and `normals` (N, 2), sensor frame. `jacobian` (N, 3): derivatives of the distances across the walls for
    x, y (metres) and heading in the sensor's frame. `share` (N,): the surface of a return over the mean of the scan's.
    `of_object` (N,): of a cluster of an object's size. `compact` (N,): of a cluster that is smaller still; for those K
    `products` (K, 9) of the derivatives, and `begins` (C,), where each of their clusters does.
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
    """How the walls of a scan lie on the map at a pose: distances `across` (N,) them, and their `weight` (N,).

    A wall that is not on the map has the weight 0. `information` (3, 3) and `gradient` (3,) are those of the weighted
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

    `information` (3, 3) of x, y and heading after it; `constrained`: whether the surroundings constrain the pose in
    every direction.
    """

    motion: SE2
    information: PlaneArray
    constrained: bool


class _Directions(NamedTuple):
    """The directions of a pose, heading `scale`d by the lever: eigenvectors of the information, and its `values`.

    A direction is `strong` where the surroundings constrain it without the compact cluster that does so most: by the
    share `needed` of their weight.
    """

    scale: PlaneArray
    scaled: PlaneArray
    values: PlaneArray
    vectors: PlaneArray
    needed: float
    strong: NDArray[np.bool_]


def walls_of(returns: ScanReturns) -> Walls:
    """The returns on walls, for `fit_at`."""
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
    """The fit of `walls` at a pose to the nearest of `map_points`, (M, 2) in the world frame."""
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
    """How many of the returns, on walls or not, lie within the kernel from the map at a pose, over `count`."""
    distance, _ = map_points.query(world_T_sensor.apply(returns.points), distance_upper_bound=kernel_m)
    return float(np.count_nonzero(np.isfinite(distance)) / count)


def _information(jacobian: PlaneArray, weight: PlaneArray) -> PlaneArray:
    """(3, 3) of distances with these derivatives (N, 3) and weights (N,)."""
    information: PlaneArray = (jacobian * weight[:, None]).T @ jacobian
    return information


def _of_compact(walls: Walls, weight: PlaneArray) -> PlaneArray:
    """The information (C, 3, 3) of each compact cluster; their returns follow one another."""
    if not len(walls.begins):
        return np.zeros((0, 3, 3))
    sums: PlaneArray = np.add.reduceat(walls.products * weight[walls.compact, None], walls.begins)
    return sums.reshape(-1, 3, 3)


def weighed_step(fit: Fit, fit_T_prior: SE2, prior: PlaneArray, settings: MatchingSettings) -> Step:
    """The step from the pose of `fit` to the best one.

    In the directions that are open the step goes to the prior; elsewhere it is the weighted mean of the match and the
    prior (`prior` (3, 3) information).
    """
    scale, scaled, _, vectors, _, strong = _directions(fit, settings)
    kept = (vectors * strong) @ vectors.T
    noise = settings.return_noise_m**2
    information = (kept @ scaled @ kept) * np.outer(scale, scale) / noise + prior
    gradient = scale * (kept @ (fit.gradient / scale)) / noise
    towards = np.array([fit_T_prior.x, fit_T_prior.y, fit_T_prior.theta])
    step = np.linalg.solve(information, prior @ towards + gradient)
    return Step(SE2(*step.tolist()), information, bool(strong.all()))


def stepped(
    pose: SE2,
    walls: Walls,
    map_points: cKDTree,
    prior: tuple[SE2, PlaneArray],
    kernel_m: float,
    settings: MatchingSettings,
) -> SE2:
    """The pose on the walls, from a `pose` nearby, and at the `prior` (pose and information) in open directions."""
    expected, information = prior
    for _ in range(MAX_STEPS):
        fit = fit_at(pose, walls, map_points, kernel_m)
        motion = weighed_step(fit, pose.inverse() @ expected, information, settings).motion
        pose = pose @ motion
        if math.hypot(motion.x, motion.y) + abs(motion.theta) < SMALL_STEP:
            break
    return pose


def by_objects(fit: Fit, walls: Walls, settings: MatchingSettings) -> bool:
    """Whether clusters of an object's size alone constrain the pose of `fit` in one direction."""
    scale, _, values, vectors, needed, strong = _directions(fit, settings)
    of_objects = _information(walls.jacobian, fit.weight * walls.of_object) / np.outer(scale, scale)
    return bool((strong & (values - _along(vectors, of_objects) < needed)).any())


def _directions(fit: Fit, settings: MatchingSettings) -> _Directions:
    scale = np.array([1.0, 1.0, max(fit.lever_m, 1e-3)])
    scaled = fit.information / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(scaled)
    of_compact = _along(vectors, fit.of_compact / np.outer(scale, scale))
    needed = settings.min_constraint * max(float(fit.weight.sum()), 1.0)
    strong = values - of_compact.max(axis=0, initial=0.0) >= needed
    return _Directions(scale, scaled, values, vectors, needed, strong)


def _along(vectors: PlaneArray, information: PlaneArray) -> PlaneArray:
    """Information (..., 3, 3) along each of the vectors, the columns of (3, 3): (..., 3)."""
    along: PlaneArray = ((information @ vectors) * vectors).sum(axis=-2)
    return along
