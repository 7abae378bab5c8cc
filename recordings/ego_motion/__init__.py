"""Ego-motion: the poses of a sensor from its scans."""

from gridtrack.recordings.ego_motion.estimation import (
    MatchedTrajectory,
    PoseSource,
    matched_trajectory,
    with_matched_poses,
)
from gridtrack.recordings.ego_motion.fit import MatchingSettings

__all__ = ["MatchedTrajectory", "MatchingSettings", "PoseSource", "matched_trajectory", "with_matched_poses"]
