"""Ego-motion: the poses of a sensor from its scans."""

from gridtrack.recordings.ego_motion.estimation import (
    MatchedTrajectory,
    matched_trajectory,
    with_matched_poses,
)

__all__ = ["MatchedTrajectory", "matched_trajectory", "with_matched_poses"]
