"""Frames whose place is recorded seldom: a joint that pans is not taken to stand without a word."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import pytest

from gridtrack.common.geometry import SE2
from gridtrack.recordings import open_recording
from gridtrack.recordings.frames.transform import SE3
from gridtrack.recordings.frames.tree import FarStamps
from gridtrack.recordings.recording import Recording

from scenes import drive_bag as made

ROS = made.Ros(1)
DURATION_MS = 80_000
AT_REST = [ROS.transforms(at, ("odom", "base_link", SE3())) for at in range(0, DURATION_MS, 100)]


def panned(tmp_path: Path, heading_deg: Mapping[int, float], topic: str = "/tf") -> Recording:
    """A scan a second of a robot at rest, and the heading of its laser at some times, ms."""
    scans = [m for k, m in enumerate(made.scans_of(ROS, DURATION_MS, made.FRONT)) if k % 10 == 0]
    joint = [
        ROS.transforms(at, ("base_link", "front_laser", SE3.in_plane(SE2(0.3, 0.0, math.radians(deg)))), topic=topic)
        for at, deg in heading_deg.items()
    ]
    return open_recording(ROS.write(tmp_path / "a.bag", [*AT_REST, *joint, *scans]), strict=False)


def test_a_joint_that_is_recorded_every_fifteen_seconds_moves(tmp_path: Path) -> None:
    recording = panned(tmp_path, {at: at / 1000 for at in range(0, 76_000, 15_000)})
    headings = [round(math.degrees(scan.world_T_sensor.theta)) for scan in recording.scans()]
    assert headings == [15 * (k // 15) for k in range(DURATION_MS // 1000)]
    assert "longest gap 15.00 s" in recording.info.poses
    assert any(
        "without poses on /tf (base_link -> front_laser) within 1 s have the last" in w for w in recording.warnings
    )


SELDOM = (
    "the place of frame 'front_laser' in 'base_link' is taken to be the same at all times, and {} on /tf: where it"
    " moves there, as a joint that pans or tilts, record it at least once a second"
)


@pytest.mark.parametrize(
    ("heading_deg", "told"),
    [
        ({0: 10.0}, "comes once"),
        ({0: 10.0, 15_000: 10.0, 60_000: 10.0}, "comes seldom, with a gap of 45.0 s,"),
        ({0: 10.0, 30_000: 10.0}, "comes seldom, with a gap of 30.0 s,"),
        ({0: 10.0, 30_000: 70.0}, "changes after a gap of 30.0 s"),
    ],
)
def test_a_joint_that_is_recorded_more_seldom_is_taken_to_rest_and_told(
    tmp_path: Path, heading_deg: dict[int, float], told: str
) -> None:
    recording = panned(tmp_path, heading_deg)
    assert {round(math.degrees(scan.world_T_sensor.theta)) for scan in recording.scans()} == {10}
    (warning,) = recording.overview().warnings
    assert warning.endswith(SELDOM.format(told))


def test_a_mount_that_is_recorded_often_or_as_static_is_not_told(tmp_path: Path) -> None:
    (tmp_path / "static").mkdir()
    often = panned(tmp_path, dict.fromkeys(range(0, DURATION_MS, 2000), 10.0))
    static = panned(tmp_path / "static", {0: 10.0}, topic="/tf_static")
    assert often.overview().warnings == static.overview().warnings == ()


def test_stamps_that_go_on_are_not_damaged_for_all_their_gaps() -> None:
    far = FarStamps()
    judged = [far.judge(at_s * 10**9) for at_s in (0, 15, 30, 31, 60, 90, 5000, 91)]
    assert judged == ["near", "held", "confirmed", "near", "near", "near", "held", "near"]


def test_two_damaged_stamps_that_go_on_do_not_make_those_after_them_damaged() -> None:
    far = FarStamps()
    judged = [far.judge(at_s * 10**9) for at_s in (0, 1, 5000, 9000, 2, 3, 4)]
    assert judged == ["near", "near", "held", "confirmed", "held", "restarted", "near"]
