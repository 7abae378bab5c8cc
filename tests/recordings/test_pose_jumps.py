"""Jumps of poses are told; fast turns, irregular stamps and gaps are none."""

from __future__ import annotations

import math

import numpy as np

from gridtrack.common.geometry import SE2
from gridtrack.recordings.pose_checks import PoseJumps

SECOND_NS = 10**9


def jumps_of(poses: list[SE2], stamps_s: list[float] | None = None) -> PoseJumps:
    jumps = PoseJumps()
    for k, pose in enumerate(poses):
        jumps.add(round((stamps_s[k] if stamps_s else 0.1 * k) * SECOND_NS) + 1, pose)
    return jumps


def test_a_drive_has_no_jumps() -> None:
    accelerating = [SE2(0.5 * 5.0 * (0.1 * k) ** 2, 0.0, 0.0) for k in range(100)]
    stopping = [*accelerating, *([accelerating[-1]] * 20)]
    turning = [SE2(0.0, 0.0, math.sin(0.1 * k) * 2.0) for k in range(100)]
    for poses in (accelerating, stopping, turning):
        assert jumps_of(poses).count == 0


def test_irregular_stamps_and_gaps_are_no_jumps() -> None:
    random = np.random.default_rng(5)
    times = np.arange(200) * 0.1
    stamps = np.sort(times + random.uniform(-0.049, 0.049, 200))
    stamps[100:] += 20.0
    poses = [SE2(1.5 * t + (30.0 if k >= 100 else 0.0), 0.0, 0.0) for k, t in enumerate(times)]
    assert jumps_of(poses, list(stamps)).count == 0


def test_jumps_are_counted_with_the_largest() -> None:
    poses = [SE2(0.05 * k + (0.6 if k >= 30 else 0.0), 0.4 if k >= 60 else 0.0, 1.0 if k >= 80 else 0.0)
             for k in range(100)]  # fmt: skip
    jumps = jumps_of(poses)
    assert jumps.count == 3
    np.testing.assert_allclose((jumps.largest_m, jumps.largest_rad), (0.6, 1.0), atol=1e-9)
    told = "its pose jumps: 3 times in the whole recording, by up to 0.60 m and 57 deg, first 3.0 s after the first"
    assert told in jumps.warning(1)
    assert jumps_of(poses[:20]).warning(1) == ""
