"""Ego-motion: the poses of a sensor from its scans."""

from gridtrack.recordings.ego_motion.estimation import (
    MatchedTrajectory,
    matched_trajectory,
    with_matched_poses,
)
from gridtrack.recordings.ego_motion.fit import MatchingSettings

__all__ = ["MatchedTrajectory", "MatchingSettings", "matched_trajectory", "with_matched_poses"]
