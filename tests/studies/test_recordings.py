"""Recordings of the studies: drives with poses of each kind, and recordings of real robots."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gridtrack.common.geometry import SE2
from gridtrack.common.scan import Scan
from gridtrack.recordings import open_recording

from studies.moving import drives_in, standing
from studies.real_results import REAL
from studies.support.shipped import DATA, DEMO

PERIOD_NS = 125_000_000


def driving(poses: list[SE2]) -> Iterator[Scan]:
    """One scan at each pose."""
    for k, pose in enumerate(poses):
        yield Scan(k * PERIOD_NS, np.ones(4, np.float32), 0.0, 1.0, 0.1, 10.0, world_T_sensor=pose)


def test_a_sensor_with_ignored_motion_stands_at_its_first_pose_and_is_scored_by_the_true_poses() -> None:
    true = [SE2(1.0, 2.0, 0.5), SE2(2.0, 2.0, 0.6), SE2(3.0, 2.5, 0.7)]
    scans = list(standing(driving(true)))
    assert [scan.world_T_sensor for scan in scans] == [true[0]] * 3
    assert [scan.reference_T_sensor for scan in scans] == true


def test_the_drives_of_a_folder_have_true_poses() -> None:
    drives = drives_in(DATA / "drives")
    assert len(drives) == 20
    assert drives[0] == "car-202"


def test_the_window_of_corridor_is_the_shipped_parts() -> None:
    (corridor,) = (one for one in REAL if one.name == "corridor")
    assert corridor.grid == open_recording(DEMO).info.grid


def test_a_laser_that_moves_is_in_the_middle_of_its_window() -> None:
    middles = {one.name: f"100x{one.cell_m:g}@-{50 * one.cell_m:g},-{50 * one.cell_m:g}" for one in REAL if one.moves}
    assert middles == {one.name: one.grid for one in REAL if one.moves}
