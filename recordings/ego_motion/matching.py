"""One scan matched with a local map of the scans before: kiss-icp's point-to-point match, refined on the walls.

kiss-icp: Vizzo et al., KISS-ICP, IEEE RA-L 2023. Its registration is used alone, since its pipeline takes no prior.
After it one Gauss-Newton step of the distances across the walls is combined with the prior by their information, in
which the directions that the walls leave open are seen (Zhang, Kaess and Singh, ICRA 2016, "solution remapping").
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from gridtrack.common.errors import RecordingError
from gridtrack.common.geometry import SE2
from gridtrack.common.pose_quality import MatchOutcome, PoseQuality
from gridtrack.common.scan import Scan
from gridtrack.recordings.ego_motion.drift_from_odometry import DriftFromOdometry
from gridtrack.recordings.ego_motion.moving_returns import EarlierScans
from gridtrack.recordings.ego_motion.prior import Prior
from gridtrack.recordings.ego_motion.returns import PlaneArray, ScanReturns, homogeneous, planar, returns_of
from gridtrack.recordings.ego_motion.settings import MatchingSettings

MAX_ITERATIONS, CONVERGED_M = 100, 1e-4
POINTS_PER_VOXEL = 20
KERNEL_REACH = 3.0
"""Returns further from the map than this many kernels have no weight."""
MATCH_M, MATCH_RAD = 0.2, math.radians(15.0)
"""Differences of a match from the prior that are never too large."""


class Fit(NamedTuple):
    """How the returns of a scan lie on the map at a pose.

    `information` (3, 3) and `gradient` (3,) are those of the weighted distances across the walls, for x, y (metres) and
    heading in the sensor's frame, in units of one return; `weight` is the sum of the weights, `lever_m` the root mean
    square distance of the returns from the sensor.
    """

    information: PlaneArray
    gradient: PlaneArray
    weight: float
    lever_m: float
    inliers: int
    residual_m: float


class ScanMatcher:
    """A local map, and the pose of each further scan in it."""

    def __init__(self, settings: MatchingSettings) -> None:
        """Raises RecordingError where kiss-icp is not installed."""
        try:
            from kiss_icp.mapping import VoxelHashMap
            from kiss_icp.registration import Registration
            from kiss_icp.voxelization import voxel_down_sample
        except ImportError:
            raise RecordingError("matching scans needs kiss-icp: pip install gridtrack[ego-motion]") from None
        self.settings = settings
        self._registration = Registration(MAX_ITERATIONS, CONVERGED_M, max_num_threads=1)
        self._map = VoxelHashMap(settings.voxel_m, settings.max_range_m, POINTS_PER_VOXEL)
        self._down_sample = voxel_down_sample
        self._earlier = EarlierScans()
        self._drift = DriftFromOdometry(settings.max_deviations)

    def start(self, scan: Scan, world_T_sensor: SE2, motion: SE2, motion_s: float) -> None:
        """Begin the map with `scan` at its pose; `motion` in the `motion_s` seconds after it."""
        returns = returns_of(scan, self.settings.max_range_m, motion, motion_s)
        self._keep(scan, returns.points, world_T_sensor)

    def match(self, scan: Scan, prior: Prior, since_s: float) -> tuple[SE2, PoseQuality]:
        """`world_T_sensor` of `scan`, `since_s` after the one before, and its quality; the scan is added to the map.

        Returns of what moves are found by a first match with all of them, and are neither matched nor kept.
        """
        returns = returns_of(scan, self.settings.max_range_m, prior.motion, since_s)
        pose, quality = prior.world_T_sensor, PoseQuality("few-returns")
        if len(returns.points) >= self.settings.min_returns and not self._map.empty():
            pose = self._aligned(returns.points, prior.world_T_sensor, prior.coarse)
            moving = self._earlier.moving(returns.points, pose, scan.stamp_ns)
            if moving.any():
                returns = ScanReturns(returns.points[~moving], returns.normals[~moving], returns.on_wall[~moving])
                pose = self._aligned(returns.points, prior.world_T_sensor, prior.coarse)
            pose, quality = self._judged(returns, pose, prior, len(moving))
            if not quality.failed and self._is_dragged(scan.stamp_ns, pose, prior):
                pose, quality = prior.world_T_sensor, replace(quality, outcome="far")
        self._keep(scan, returns.points, pose)
        return pose, quality

    def _keep(self, scan: Scan, points: PlaneArray, world_T_sensor: SE2) -> None:
        self._map.update(self._thinned(points), homogeneous(world_T_sensor))
        self._earlier.add(scan, world_T_sensor)

    def _thinned(self, points: PlaneArray) -> PlaneArray:
        """Points (N, 2) as (n, 3) at z = 0, one for each voxel of the spacing."""
        flat = np.concatenate([points, np.zeros((len(points), 1))], axis=1)
        thinned: PlaneArray = self._down_sample(flat, self.settings.point_spacing_m)
        return thinned.reshape(-1, 3)

    def _aligned(self, points: PlaneArray, world_T_sensor: SE2, coarse: bool) -> SE2:
        """kiss-icp's match, from coarse to fine where the predicted pose may be far off."""
        pose, thinned = homogeneous(world_T_sensor), self._thinned(points)
        kernels = (self.settings.coarse_kernel_m,) if coarse else ()
        for kernel in (*kernels, self.settings.kernel_m):
            pose = self._registration.align_points_to_map(thinned, self._map, pose, KERNEL_REACH * kernel, kernel)
        aligned = planar(pose)
        return aligned if all(map(math.isfinite, (aligned.x, aligned.y, aligned.theta))) else world_T_sensor

    def _judged(self, returns: ScanReturns, aligned: SE2, prior: Prior, count: int) -> tuple[SE2, PoseQuality]:
        """The pose from the match and the prior, or the prior's; `count` returns, with those of what moves."""
        settings = self.settings
        fit = fit_at(aligned, returns, self._map.point_cloud()[:, :2], settings.kernel_m)
        inlier_share = fit.inliers / count
        outcome: MatchOutcome = "matched"
        if inlier_share < settings.min_inlier_share:
            outcome = "few-inliers"
        elif _is_far(aligned, prior, settings.max_deviations):
            outcome = "far"
        if outcome != "matched":
            return prior.world_T_sensor, PoseQuality(outcome, inlier_share, fit.residual_m)
        step, constrained = weighed_step(fit, aligned.inverse() @ prior.world_T_sensor, prior.information, settings)
        return aligned @ step, PoseQuality("matched" if constrained else "partial", inlier_share, fit.residual_m)

    def _is_dragged(self, stamp_ns: int, pose: SE2, prior: Prior) -> bool:
        """Whether the matches of the last second lead away from odometry; without odometry there is no telling."""
        position_m = 1.0 / math.sqrt(prior.information[0, 0])
        return not prior.coarse and self._drift.grows(stamp_ns, prior.world_T_sensor, pose, position_m)


def fit_at(world_T_sensor: SE2, returns: ScanReturns, map_points: PlaneArray, kernel_m: float) -> Fit:
    """The fit of `returns` at a pose to the nearest of `map_points` (M, 2), world frame."""
    there = world_T_sensor.apply(returns.points)
    distance, nearest = cKDTree(map_points).query(there, distance_upper_bound=KERNEL_REACH * kernel_m)
    found = np.isfinite(distance)
    on_map = found & returns.on_wall
    points, normals = returns.points[on_map], returns.normals[on_map]
    apart = SE2(theta=-world_T_sensor.theta).apply(map_points[nearest[on_map]] - there[on_map])
    across = np.einsum("ni,ni->n", apart, normals)
    weight = (kernel_m**2 / (kernel_m**2 + across**2)) ** 2
    lever = points[:, 0] * normals[:, 1] - points[:, 1] * normals[:, 0]
    jacobian = np.column_stack([normals, lever])
    return Fit(
        information=(jacobian * weight[:, None]).T @ jacobian,
        gradient=jacobian.T @ (weight * across),
        weight=float(weight.sum()),
        lever_m=float(np.sqrt(np.mean(points**2) * 2.0)) if len(points) else 1.0,
        inliers=int(np.count_nonzero(distance <= kernel_m)),
        residual_m=float(np.median(np.abs(across))) if len(across) else 0.0,
    )


def weighed_step(fit: Fit, aligned_T_prior: SE2, prior: PlaneArray, settings: MatchingSettings) -> tuple[SE2, bool]:
    """The step from the aligned pose to the best one, and whether the walls constrain it in every direction.

    Along the eigenvectors of the information, heading scaled by the lever, that the walls leave open the step goes to
    the prior; elsewhere it is the weighted mean of the match and the prior (`prior` (3, 3) information).
    """
    scale = np.array([1.0, 1.0, max(fit.lever_m, 1e-3)])
    values, vectors = np.linalg.eigh(fit.information / np.outer(scale, scale))
    strong = values >= settings.min_constraint * max(fit.weight, 1.0)
    kept = (vectors * strong) @ vectors.T
    scaled = (kept @ (fit.information / np.outer(scale, scale)) @ kept) / settings.return_noise_m**2
    information = scaled * np.outer(scale, scale)
    gradient = scale * (kept @ (fit.gradient / scale)) / settings.return_noise_m**2
    towards = np.array([aligned_T_prior.x, aligned_T_prior.y, aligned_T_prior.theta])
    step = np.linalg.solve(information + prior, prior @ towards + gradient)
    return SE2(*step.tolist()), bool(strong.all())


def _is_far(aligned: SE2, prior: Prior, max_deviations: float) -> bool:
    """Whether the match is further from the prior than its noise and that of a match explain."""
    off = prior.world_T_sensor.inverse() @ aligned
    position_m, _, heading_rad = 1.0 / np.sqrt(np.diag(prior.information))
    return bool(
        math.hypot(off.x, off.y) > MATCH_M + max_deviations * position_m
        or abs(off.theta) > MATCH_RAD + max_deviations * heading_rad
    )
