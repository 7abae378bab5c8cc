"""Two lasers on one topic are recognised, and either can be read alone."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np
import pytest

from gridtrack.common.errors import RecordingError
from gridtrack.common.geometry import SE2
from gridtrack.recordings import open_recording

from scenes import drive_bag as made

Bag = Callable[..., Path]
ROS = made.Ros(1)
STATIC = ROS.transforms(0, *made.mounts(made.FRONT, made.REAR), topic="/tf_static")
MOVING = made.moving(ROS, "odom", "base_link")
BACK = made.Laser("back", SE2(0.0, 0.0, math.radians(-160)), offset_ms=50)


def on_scan(messages: Iterable[made.Message], frame: str = "") -> Iterator[made.Message]:
    """The messages on the topic /scan, in the frame given, or each in its own."""
    for _, kind, at_ns, message in messages:
        message.header.frame_id = frame or message.header.frame_id
        yield ("/scan", kind, at_ns, message)


def both(frame: str = "") -> list[made.Message]:
    return list(on_scan(made.scans_of(ROS, made.DURATION_MS, made.FRONT, made.REAR), frame))


def test_scans_in_two_frames_are_of_two_lasers(bag: Bag) -> None:
    path = bag(*both(), STATIC, *MOVING)
    recording = open_recording(path)
    assert made.walls_stay(recording.scans(), 2 * made.SCANS)
    assert list(recording.survey.sensors) == ["scan", "scan@rear_laser"]
    (reported,) = recording.warnings
    assert "/scan has scans in several frames, front_laser, rear_laser: read as several lasers" in reported
    assert "one alone with --topic /scan or --topic /scan@rear_laser" in reported
    for topic in ("/scan", "/scan@rear_laser"):
        alone = open_recording(path, topic=topic, strict=True)
        assert made.walls_stay(alone.scans())
        assert list(alone.survey.sensors) == [topic.removeprefix("/")]
    with pytest.raises(RecordingError, match="no topic '/scan@raer'"):
        list(open_recording(path, topic="/scan@raer").scans())


def test_two_lasers_with_unknown_mounts_are_refused_with_a_command_for_each(bag: Bag) -> None:
    problem = open_recording(bag(*both())).pose_problem
    assert "several sensors (scan, scan@rear_laser) with unknown mounts" in problem
    assert "--topic /scan`, or --topic /scan@rear_laser; or all of them with" in problem


def alternating(seconds: int = 5, lost: tuple[int, ...] = ()) -> list[made.Message]:
    """Scans of two lasers on a robot at rest, in one frame, without the numbers `lost`."""
    lasers, person = (made.FRONT, BACK), (50.0, 50.0)
    scans = [
        ROS.laser(100 * k + laser.offset_ms, made.ranges_at(laser, SE2(1.0, 0.5, 0.2), person), laser, "laser")
        for k in range(10 * seconds)
        for laser in lasers
    ]
    return [one for k, one in enumerate(on_scan(scans)) if k not in lost]


def test_scans_that_alternate_between_two_views_are_a_warning(bag: Bag) -> None:
    (reported,) = [line for line in open_recording(bag(*alternating())).overview().warnings if "alternate" in line]
    assert "sensor 'scan': its scans alternate between two views, as those of two lasers on one topic do" in reported
    assert "--out a-one.mcap --topic /scan@1`, or --topic /scan@2" in reported


@pytest.mark.parametrize("lost", [(), (1,), (4, 11, 12, 13)])
def test_each_of_two_lasers_in_one_frame_can_be_read(bag: Bag, lost: tuple[int, ...]) -> None:
    path = bag(*alternating(lost=lost))
    views = [made.ranges_at(laser, SE2(1.0, 0.5, 0.2), (50.0, 50.0)) for laser in (made.FRONT, BACK)]
    for number, view in enumerate(views):
        recording = open_recording(path, topic=f"/scan@{number + 1}", strict=True)
        found = list(recording.scans())
        assert len(found) == 50 - sum(k % 2 == number for k in lost)
        assert all(np.array_equal(scan.ranges, view) for scan in found)
        assert not [line for line in recording.overview().warnings if "alternate" in line]


def test_one_laser_that_turns_fast_is_no_two_lasers(bag: Bag) -> None:
    scans = [
        ROS.laser(100 * k, made.ranges_at(made.FRONT, SE2(1.0, 0.5, 0.5 * k), (50.0, 50.0)), made.FRONT)
        for k in range(50)
    ]
    assert not [line for line in open_recording(bag(*scans)).overview().warnings if "alternate" in line]
