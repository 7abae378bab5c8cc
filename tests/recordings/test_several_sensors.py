"""Frames of several sensors: all are in every frame, and a sensor without scans moves like the others."""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gridtrack.common.errors import RecordingError
from gridtrack.common.geometry import SE2, same_pose
from gridtrack.common.grid import GridSpec, window_about
from gridtrack.common.scan import Scan
from gridtrack.recordings import open_recording
from gridtrack.recordings.stream import open_stream
from tests.recordings.conftest import digests, one_beam

GRID = GridSpec(60, 0.2)
FRONT, REAR = SE2(0.47, 0.13, 0.2), SE2(-0.5, 0.0, math.pi)
BEHIND = SE2(-2.0, 0.0, math.pi)
SCANS = 40


def by_stamp(*scans: Iterable[Scan]) -> list[Scan]:
    return sorted((scan for of_sensor in scans for scan in of_sensor), key=lambda scan: scan.stamp_ns)


def test_several_sensors_share_the_frame_of_the_first(write, scan) -> None:
    """A front sensor at the origin, and one 2 m behind it that faces backwards; each has one return at 1.1 m."""
    front = [one_beam(scan(k, "front"), 1.1) for k in range(5)]
    rear = [one_beam(scan(k, "rear", offset_ns=1), 1.1, world_T_sensor=BEHIND) for k in range(5)]
    path = write(by_stamp(front, rear))
    for points in ("centres", "raw"):
        for frame in open_stream(path, grid=GRID, points=points, rate_hz=10.0):
            np.testing.assert_allclose(frame.origins, [[0.0, 0.0], [-2.0, 0.0]], atol=1e-6)
            order = np.argsort(frame.point_origin)
            np.testing.assert_allclose(frame.points[order][:, 0], [1.1, -3.1], atol=0.11)
            assert frame.point_origin[order].tolist() == [0, 1]
            assert frame.point_origin.dtype == np.uint8


def test_a_cell_is_occupied_if_one_sensor_sees_it_occupied_and_another_sees_through_it(write, scan) -> None:
    ends = one_beam(scan(0, "front"), 1.1)
    passes = one_beam(scan(0, "rear", offset_ns=1), 4.0, world_T_sensor=SE2(-2.0, 0.0, 0.0))
    (frame,) = open_stream(write([ends, passes]), grid=GRID, rate_hz=10.0)
    assert np.argwhere(frame.occupied).tolist() == [[30, 35], [30, 40]]
    assert frame.visible[30, 20:41].all(), "free where any beam passed"
    assert frame.point_origin.tolist() == [0, 1]


def test_jittering_sensors_half_a_period_apart_are_both_in_every_frame(write, scan) -> None:
    jitter = np.random.default_rng(5).integers(-4_000_000, 4_000_000, (2, SCANS)).tolist()
    front = [one_beam(scan(k, "front", offset_ns=4_000_000 + jitter[0][k]), 1.1) for k in range(SCANS)]
    rear = [
        one_beam(scan(k, "rear", offset_ns=54_000_000 + jitter[1][k]), 1.1, world_T_sensor=BEHIND) for k in range(SCANS)
    ]
    frames = list(open_stream(write(by_stamp(front, rear)), grid=GRID, rate_hz=10.0))
    assert [int(frame.occupied.sum()) for frame in frames[1:-1]] == [2] * (len(frames) - 2)


def test_late_or_missing_scans_of_a_sensor_are_one_warning(write, scan) -> None:
    front = [one_beam(scan(k, "front"), 1.1) for k in range(20)]
    offsets_ns = {k: 60_000_000 if k == 7 else 1 for k in range(20) if not 11 <= k < 14}
    rear = [one_beam(scan(k, "rear", offset_ns=at), 1.1, world_T_sensor=BEHIND) for k, at in offsets_ns.items()]
    stream = open_stream(write(by_stamp(front, rear)), grid=GRID, rate_hz=10.0)
    (warning,) = stream.recording.warnings
    assert warning.endswith(
        "sensor 'rear': no scan within 0.05 s of 4 of 20 frames in 0s-1.9s, the first at 0.70 s; they"
        " are made from the scans of the other sensors"
    )
    assert [int(frame.occupied.sum()) for frame in stream] == [1 if k in (7, 11, 12, 13) else 2 for k in range(20)]
    assert all(frame.origins.shape == (2, 2) for frame in stream)


def test_a_slow_sensor_that_sets_the_rate_is_a_warning(write, scan) -> None:
    front = [scan(k) for k in range(SCANS)]
    rear = [one_beam(scan(k, "rear", offset_ns=1), 1.1, world_T_sensor=BEHIND) for k in range(0, SCANS, 4)]
    path = write(by_stamp(front, rear))
    stream = open_stream(path, grid=GRID)
    assert len(stream) == 10
    (warning,) = stream.recording.warnings
    assert "the slowest sensor sets the rate of the frames: 'rear' has" in warning
    assert open_stream(path, grid=GRID, rate_hz=1 / stream.period_s).recording.warnings == []


def test_several_sensors_with_unknown_mounts_are_an_error_with_their_topics(write, scan) -> None:
    path = write([scan(k, sensor) for k in range(5) for sensor in ("front", "rear")])
    message = r"several sensors \(front, rear\).*import one of them.*--topic /scan/front`, or --topic /scan/rear"
    with pytest.raises(RecordingError, match=message):
        open_stream(path)
    assert len(open_stream(path, topic="/scan/rear")) == 5
    assert "several sensors (front, rear)" in open_recording(path).overview().warnings[0]


# ---- a sensor without scans moves like the others


def robot_at(k: float) -> SE2:
    """A circle of 4 m radius, 0.2 m and 3 degrees per scan."""
    return SE2(4.0 * math.cos(0.05 * k), 4.0 * math.sin(0.05 * k), 0.05 * k + math.pi / 2)


@pytest.fixture
def drive(write, scan) -> Callable[..., Path]:
    """`drive(front, rear)` writes a drive with these scans of each sensor, the rear ones 20 ms later."""

    def drive(front: Container[int], rear: Container[int] = range(SCANS)) -> Path:
        scans = []
        for k in range(SCANS):
            scans += [scan(k, "front", robot_at(k) @ FRONT)] if k in front else []
            scans += [scan(k, "rear", robot_at(k + 0.2) @ REAR, 20_000_000)] if k in rear else []
        return write(scans)

    return drive


@pytest.mark.parametrize("without", [range(20, SCANS), range(20, 30), (7, 11, 12, 30)])
def test_the_window_stays_about_the_first_sensor_in_its_gaps(
    drive: Callable[..., Path], without: Container[int]
) -> None:
    frames = list(open_stream(drive([k for k in range(SCANS) if k not in without]), grid=GRID, rate_hz=10.0))
    assert len(frames) == SCANS
    for k, frame in enumerate(frames):
        first = robot_at(k) @ FRONT
        found = frame.world_T_grid.apply(frame.origins[:1].astype(float))
        np.testing.assert_allclose(found, [[first.x, first.y]], atol=0.03 if k in without else 1e-6)
        assert frame.world_T_grid == window_about(SE2(*found[0]), GRID.cell_m)
        assert frame.visible.any()


def test_a_sensor_without_scans_moves_like_the_others(drive: Callable[..., Path]) -> None:
    frames = list(open_stream(drive(range(SCANS), range(20)), grid=GRID, rate_hz=10.0))
    places = [frame.world_T_grid.apply(frame.origins[1:].astype(float))[0] for frame in frames]
    expected = [((pose := robot_at(k) @ REAR).x, pose.y) for k in range(SCANS)]
    np.testing.assert_allclose(places, expected, atol=0.06)


@pytest.mark.parametrize("seed", range(3))
def test_stretches_are_slices_of_the_whole_if_sensors_miss_scans(drive: Callable[..., Path], seed: int) -> None:
    front, rear = np.random.default_rng(seed).random((2, SCANS)) < 0.4
    front[0] = rear[-1] = True
    if seed == 2:
        front[5:], rear[:9] = False, False
    path = drive(*(np.flatnonzero(kept).tolist() for kept in (front, rear)))
    whole = digests(open_stream(path, grid=GRID, rate_hz=10.0))
    assert len(whole) == SCANS
    for first in range(1, SCANS - 1, 7):
        assert digests(open_stream(f"{path}@{first / 10}s-", grid=GRID, rate_hz=10.0)) == whole[first:]


def test_a_sensor_without_scans_stays_if_the_others_are_at_rest(write, scan) -> None:
    place, other = SE2(3.3, -1.1, 0.7), SE2(-7.77, 1.3, -2.9)
    scans = [
        s for k in range(9) for s in (scan(k, "front", place), scan(k, "rear", other, 1)) if k < 4 or s.sensor == "rear"
    ]
    frames = list(open_stream(write(scans), grid=GRID, rate_hz=10.0))
    assert {frame.world_T_grid for frame in frames} == {window_about(place, GRID.cell_m)}
    assert len({frame.origins.tobytes() for frame in frames}) == 1


def test_reference_poses_follow_the_sensors_with_scans(
    drive: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    stream = open_stream(drive(range(20)), grid=GRID, rate_hz=10.0)

    def reference_T_world(stamp_ns: int) -> SE2:
        return SE2((stamp_ns - stream.recording.survey.first_ns) / 1e9, 0.0, 0.1)

    scans = [
        replace(s, reference_T_sensor=reference_T_world(s.stamp_ns) @ s.world_T_sensor)
        for s in stream.recording.scans()
    ]
    monkeypatch.setattr(stream.recording, "scans", lambda *_: iter(scans))
    for k, observation in enumerate(stream.observations()):
        expected = SE2(0.1 * k + (0.0 if k < 20 else 0.02), 0.0, 0.1)
        assert same_pose(observation.reference_T_world, expected)
