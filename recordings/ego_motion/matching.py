"""Matching of one scan with a local map of the scans before it."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from gridtrack.common.errors import RecordingError
from gridtrack.common.geometry import SE2
from gridtrack.common.scan import MatchOutcome, PoseQuality, Scan
from gridtrack.recordings.ego_motion.fit import (
    KERNEL_M,
    KERNEL_REACH,
    MIN_INLIER_SHARE,
    MIN_RETURNS,
    by_objects,
    fit_at,
    share_on_map,
    stepped,
    walls_of,
    weighed_step,
)
from gridtrack.recordings.ego_motion.prior import Prior, inverse
from gridtrack.recordings.ego_motion.returns import (
    MATCHED_RANGE_M,
    EarlierScans,
    PlaneArray,
    ScanReturns,
    homogeneous,
    measured_points,
    planar,
    returns_of,
)

COARSE_KERNEL_M = 0.5
"""Scale of the registration's kernel without odometry."""
VOXEL_M, POINT_SPACING_M, MAP_SPACING_M = 0.3, 0.1, 0.03
"""Sides of the voxels of the local map, and of those by which returns are thinned for the registration and for the
map."""
MAX_DEVIATIONS = 5.0
"""Maximum distance of a match from the prior: this many standard deviations, plus 20 cm or 15 deg."""
MAX_ITERATIONS, CONVERGED_M = 100, 1e-4
POINTS_PER_VOXEL = 20
PRIOR_SHARE = 1e-4
"""Share of the prior's information in the steps on the walls: it decides weak directions alone."""
MATCH_M, MATCH_RAD = 0.2, math.radians(15.0)
"""Distances of a match from the prior that are always accepted."""
WINDOW_NS = 1_000_000_000
DRIFT_M = 0.1
"""A drift in the window that is always accepted: matching noise."""
MIN_SCANS = 4
"""Number of matches in the window from which a drift is checked."""


class DriftFromOdometry:
    """The sum of the differences between matches and odometry over the last second."""

    def __init__(self) -> None:
        self._steps: deque[tuple[int, PlaneArray, float]] = deque()

    def grows(self, stamp_ns: int, predicted: SE2, matched: SE2, position_m: float) -> bool:
        """Add a match; True if the sum of all differences is larger than the noise.

        `position_m` is the standard deviation of the prior. The largest difference does not count: a wheel may slip.
        """
        self._steps.append((stamp_ns, np.array([matched.x - predicted.x, matched.y - predicted.y]), position_m))
        while stamp_ns - self._steps[0][0] > WINDOW_NS:
            self._steps.popleft()
        if len(self._steps) < MIN_SCANS:
            return False
        off = np.array([step for _, step, _ in self._steps])
        slip = int(np.hypot(*off.T).argmax())
        drift = off.sum(axis=0) - off[slip]
        noise_m = math.sqrt(sum(sigma**2 for _, _, sigma in self._steps))
        return float(np.hypot(*drift)) > DRIFT_M + MAX_DEVIATIONS * noise_m


class ScanMatch(NamedTuple):
    """`world_T_sensor` of a scan, its quality, and the information (3, 3) of x, y and heading, sensor frame.

    `by_objects`: clusters of an object's size alone constrain a direction; they may move together.
    """

    world_T_sensor: SE2
    quality: PoseQuality
    information: PlaneArray
    by_objects: bool = False


class ScanMatcher:
    """Matches scans with a local map of the scans before."""

    def __init__(self) -> None:
        """Raises RecordingError if kiss-icp is not installed."""
        try:
            from kiss_icp.mapping import VoxelHashMap
            from kiss_icp.registration import Registration
            from kiss_icp.voxelization import voxel_down_sample
        except ImportError:
            raise RecordingError("matching scans needs kiss-icp: pip install 'gridtrack[ego-motion]'") from None
        self._registration = Registration(MAX_ITERATIONS, CONVERGED_M, max_num_threads=1)
        self._map = VoxelHashMap(VOXEL_M, MATCHED_RANGE_M, POINTS_PER_VOXEL)
        self._down_sample = voxel_down_sample
        self._earlier = EarlierScans()
        self._drift = DriftFromOdometry()

    def start(self, scan: Scan, world_T_sensor: SE2, motion: SE2, motion_s: float) -> None:
        """Begin the map with `scan` at its pose; `motion` is the sensor's motion in the `motion_s` seconds after it."""
        returns = returns_of(scan, motion, motion_s)
        self._keep(scan, returns, world_T_sensor)

    def match(self, scan: Scan, prior: Prior, since_s: float) -> ScanMatch:
        """The match of `scan`, `since_s` after the scan before; the scan is added to the map."""
        returns = returns_of(scan, prior.motion, since_s)
        failed = ScanMatch(prior.world_T_sensor, PoseQuality("few-returns"), prior.information)
        found = failed
        if len(returns.points) >= MIN_RETURNS and not self._map.empty():
            found, returns = self._matched(scan, returns, prior)
            if not found.quality.failed and self._is_dragged(scan.stamp_ns, found.world_T_sensor, prior):
                far = PoseQuality("far", found.quality.inlier_share, found.quality.residual_m)
                found = failed._replace(quality=far)
        self._keep(scan, returns, found.world_T_sensor)
        return found

    def _keep(self, scan: Scan, returns: ScanReturns, world_T_sensor: SE2) -> None:
        self._map.update(self._thinned(returns, MAP_SPACING_M), homogeneous(world_T_sensor))
        points, _ = measured_points(scan)
        self._earlier.add(scan, points, world_T_sensor)

    def _thinned(self, returns: ScanReturns, spacing_m: float) -> PlaneArray:
        """The returns as points (n, 3) at z = 0, one per voxel of the spacing."""
        flat = np.concatenate([returns.points, np.zeros((len(returns.points), 1))], axis=1)
        thinned: PlaneArray = self._down_sample(flat, spacing_m)
        return thinned.reshape(-1, 3)

    def _matched(self, scan: Scan, returns: ScanReturns, prior: Prior) -> tuple[ScanMatch, ScanReturns]:
        """The match of `returns`, and the returns used for it: without returns that move by a first match of all.

        If too few are left, all are used: a poor first match, or walls that sometimes return nothing and so seem free,
        are more likely than mostly moving surroundings.
        """
        # the tree is used once: an unbalanced one gives the same answer and is built faster
        map_points = cKDTree(self._map.point_cloud()[:, :2], balanced_tree=False)
        pose = self._aligned(returns, map_points, prior)
        moving = self._earlier.moving(scan, returns, pose)
        if not moving.any():
            return self._judged(returns, pose, map_points, prior, len(moving)), returns
        still = returns.only(~moving)
        found = self._judged(still, self._aligned(still, map_points, prior), map_points, prior, len(moving))
        if found.quality.failed:
            of_all = self._judged(returns, pose, map_points, prior, len(moving))
            if not of_all.quality.failed:
                return of_all, returns
        return found, still

    def _aligned(self, returns: ScanReturns, map_points: cKDTree, prior: Prior) -> SE2:
        """The pose at which the returns lie on the map: kiss-icp's registration, then steps on the walls."""
        weak = (prior.world_T_sensor, PRIOR_SHARE * prior.information)
        return stepped(self._registered(returns, prior), walls_of(returns), map_points, weak, KERNEL_M)

    def _registered(self, returns: ScanReturns, prior: Prior) -> SE2:
        """The pose by kiss-icp's registration, with a wide kernel if the prior is coarse."""
        kernel_m = COARSE_KERNEL_M if prior.coarse else KERNEL_M
        points, begin = self._thinned(returns, POINT_SPACING_M), homogeneous(prior.world_T_sensor)
        pose = self._registration.align_points_to_map(points, self._map, begin, KERNEL_REACH * kernel_m, kernel_m)
        found = planar(pose)
        return found if all(map(math.isfinite, (found.x, found.y, found.theta))) else prior.world_T_sensor

    def _judged(self, returns: ScanReturns, pose: SE2, map_points: cKDTree, prior: Prior, count: int) -> ScanMatch:
        """The pose from match and prior, or the prior's if the match is rejected; `count` includes moving returns."""
        walls = walls_of(returns)
        fit = fit_at(pose, walls, map_points, KERNEL_M)
        inlier_share = share_on_map(pose, returns, map_points, KERNEL_M, count)
        outcome: MatchOutcome = "matched"
        if inlier_share < MIN_INLIER_SHARE:
            outcome = "few-inliers"
        elif _is_far(pose, prior):
            outcome = "far"
        if outcome != "matched":
            return ScanMatch(
                prior.world_T_sensor, PoseQuality(outcome, inlier_share, fit.residual_m), prior.information
            )
        step = weighed_step(fit, pose.inverse() @ prior.world_T_sensor, prior.information)
        outcome = "matched" if step.constrained else "partial"
        quality = PoseQuality(outcome, inlier_share, fit.residual_m)
        return ScanMatch(pose @ step.motion, quality, step.information, by_objects(fit, walls))

    def _is_dragged(self, stamp_ns: int, pose: SE2, prior: Prior) -> bool:
        """Whether the matches of the last second drift from odometry; always False without odometry."""
        position_m = 1.0 / math.sqrt(prior.information[0, 0])
        return not prior.coarse and self._drift.grows(stamp_ns, prior.world_T_sensor, pose, position_m)


def _is_far(match: SE2, prior: Prior) -> bool:
    """Whether the match is further from the prior than the noise of both explains."""
    off = prior.world_T_sensor.inverse() @ match
    x_m, y_m, heading_rad = np.sqrt(np.diag(inverse(prior.information)))
    return bool(
        math.hypot(off.x, off.y) > MATCH_M + MAX_DEVIATIONS * max(x_m, y_m)
        or abs(off.theta) > MATCH_RAD + MAX_DEVIATIONS * heading_rad
    )
