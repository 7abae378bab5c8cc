"""The window of a robot with several sensors goes on with the robot where the first one has no scans."""

from __future__ import annotations

import math
from collections.abc import Callable, Container
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gridtrack.common.geometry import SE2, same_pose
from gridtrack.common.grid import GridSpec, window_about
from gridtrack.recordings.stream import frame_digest, open_stream

GRID = GridSpec(60, 0.2)
FRONT, REAR = SE2(0.47, 0.13, 0.2), SE2(-0.5, 0.0, math.pi)
SCANS = 60


def robot_at(k: float) -> SE2:
    """On a circle of 4 m, 0.2 m and 3 degrees a scan."""
    return SE2(4.0 * math.cos(0.05 * k), 4.0 * math.sin(0.05 * k), 0.05 * k + math.pi / 2)


@pytest.fixture
def drive(write, scan) -> Callable[..., Path]:
    """`drive(front, rear)`: a drive whose sensors have the scans of these numbers, the rear one 20 ms later."""

    def drive(front: Container[int], rear: Container[int] = range(SCANS)) -> Path:
        scans = []
        for k in range(SCANS):
            scans += [scan(k, "front", robot_at(k) @ FRONT)] if k in front else []
            scans += [scan(k, "rear", robot_at(k + 0.2) @ REAR, 20_000_000)] if k in rear else []
        return write(scans)

    return drive


@pytest.mark.parametrize("without", [range(20, SCANS), range(20, 40), (7, 11, 12, 30)])
def test_the_window_stays_about_the_first_sensor_where_it_has_no_scans(
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


def test_a_sensor_without_scans_is_carried_along(drive: Callable[..., Path]) -> None:
    frames = list(open_stream(drive(range(SCANS), range(20)), grid=GRID, rate_hz=10.0))
    places = [frame.world_T_grid.apply(frame.origins[1:].astype(float))[0] for frame in frames]
    expected = [((pose := robot_at(k) @ REAR).x, pose.y) for k in range(SCANS)]
    np.testing.assert_allclose(places, expected, atol=0.06)


@pytest.mark.parametrize("seed", range(4))
def test_stretches_are_slices_of_the_whole_where_sensors_miss_scans(drive: Callable[..., Path], seed: int) -> None:
    front, rear = np.random.default_rng(seed).random((2, SCANS)) < 0.4
    front[0] = rear[-1] = True
    if seed == 3:
        front[5:], rear[:9] = False, False
    path = drive(*(np.flatnonzero(kept).tolist() for kept in (front, rear)))
    whole = [frame_digest(frame) for frame in open_stream(path, grid=GRID, rate_hz=10.0)]
    assert len(whole) == SCANS
    for first in range(1, SCANS - 1, 5):
        assert [frame_digest(f) for f in open_stream(f"{path}@{first / 10}s-", grid=GRID, rate_hz=10.0)] == whole[
            first:
        ]


def test_a_sensor_without_scans_stays_where_the_others_stand(write, scan) -> None:
    place, other = SE2(3.3, -1.1, 0.7), SE2(-7.77, 1.3, -2.9)
    scans = [
        s for k in range(9) for s in (scan(k, "front", place), scan(k, "rear", other, 1)) if k < 4 or s.sensor == "rear"
    ]
    frames = list(open_stream(write(scans), grid=GRID, rate_hz=10.0))
    assert {frame.world_T_grid for frame in frames} == {window_about(place, GRID.cell_m)}
    assert len({frame.origins.tobytes() for frame in frames}) == 1


def test_reference_poses_go_on_with_the_sensors_that_have_scans(
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
