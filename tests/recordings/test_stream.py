"""A grid stream has the same regular frames for every reader: slices of one whole, about the first sensor."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from gridtrack.common.errors import RecordingError
from gridtrack.common.geometry import SE2, same_pose
from gridtrack.common.grid import GridFrame, GridSpec, shift_between
from gridtrack.common.raycast import cast_scan
from gridtrack.common.scan import Scan
from gridtrack.evaluation.referee.referee import refuse_moving
from gridtrack.recordings import open_recording, packaged_recording
from gridtrack.recordings.observation import cells_in_window
from gridtrack.recordings.stream import GridStream, frame_digest, open_stream
from tests.recordings.conftest import digests, one_beam

GRID = GridSpec(60, 0.2)


def test_frames_are_the_scans_cast_into_the_grid(write, scan) -> None:
    scans = [scan(k) for k in range(12)]
    stream = open_stream(write(scans), grid=GRID)
    frames = list(stream)
    assert len(stream) == len(frames) == 12
    assert stream.period_s == 0.1
    for frame, source in zip(frames, scans, strict=True):
        visible, occupied = np.zeros(GRID.shape, bool), np.zeros(GRID.shape, bool)
        cast_scan(source, GRID, SE2(), visible, occupied)
        np.testing.assert_array_equal(frame.visible, visible)
        np.testing.assert_array_equal(frame.occupied, occupied)
        assert frame.stamp_ns == source.stamp_ns


def test_every_iteration_starts_at_the_first_frame(write, scan) -> None:
    stream = open_stream(write(scan(k) for k in range(12)))
    started = iter(stream)
    next(started)
    whole = digests(stream)
    assert whole == digests(stream)
    assert digests(started) == whole[1:]


def test_a_stretch_is_a_slice_of_the_whole(write, scan) -> None:
    stretches = {"train": (0.0, 1.5), "validation": (1.5, 2.04), "test": (2.04, None)}
    path = write((scan(k, offset_ns=(k * 7919) % 30_000_000) for k in range(40)), stretches=stretches)
    whole = digests(open_stream(path, rate_hz=10.0))
    parts = [open_stream(f"{path}@{name}", rate_hz=10.0) for name in stretches]
    assert [len(p) for p in parts] == [15, 6, len(whole) - 21]
    assert digests(frame for part in parts for frame in part) == whole
    assert digests(open_stream(f"{path}@1.5s-2.04s", rate_hz=10.0)) == whole[15:21]


def test_the_stream_has_the_metadata_of_the_recording(write, scan) -> None:
    path = write(
        (scan(k) for k in range(30)),
        site="hall",
        grid="50x0.1@-1,-2.5",
        rate_hz=5.0,
        classes=["car"],
        stretches={"test": (1.0, None)},
    )
    stream = open_stream(f"{path}@test")
    assert (stream.name, stream.site, stream.classes) == ("made.mcap@test", "hall", ("car",))
    assert (str(stream.grid), stream.period_s, stream.stretch_s) == ("50x0.1@-1,-2.5", 0.2, (1.0, pytest.approx(2.9)))
    assert open_stream(f"{path}@0s-2s").name == "made.mcap@0s-2s"
    assert open_stream(path, rate_hz=10.0, grid=GRID).period_s == 0.1
    assert stream.sha256 == open_recording(path).sha256


def test_without_metadata_the_grid_is_the_default_and_the_rate_the_median(write, scan) -> None:
    stream = open_stream(write(scan(k, offset_ns=-k * 300_000) for k in range(30)))
    assert stream.grid == GridSpec(50, 0.2)
    assert stream.period_s == 0.1


def test_an_invalid_rate_is_refused(write, scan) -> None:
    path = write([scan(0)])
    with pytest.raises(RecordingError, match="give one with --rate"):
        open_stream(path)
    with pytest.raises(RecordingError, match="a rate of -1 Hz"):
        open_stream(path, rate_hz=-1.0)


def test_gaps_are_counted_and_their_frames_empty(write, scan) -> None:
    path = write(scan(k) for k in range(40) if not 10 <= k < 15 and k != 20)
    stream = open_stream(path)
    frames = list(stream)
    assert len(frames) == 40
    assert stream.gaps == 1
    empty = [k for k, frame in enumerate(frames) if not frame.visible.any()]
    assert empty == [10, 11, 12, 13, 14]
    assert all(len(frames[k].points) == 0 and frames[k].origins.shape == (1, 2) for k in empty)
    assert len(stream.recording.warnings) == 1
    assert (
        "gaps longer than two periods of 0.1 s in 0s-3.9s: 1, the longest 0.60 s from 0.90 s on"
        in (stream.recording.warnings[0])
    )
    assert open_stream(f"{path}@2s-3s").gaps == 0


def test_the_window_of_a_rotated_sensor_is_parallel_to_the_world(write, scan) -> None:
    pose = SE2(10.05, 20.0, math.pi / 2)
    frames = list(open_stream(write(one_beam(scan(k), 3.1, world_T_sensor=pose) for k in range(3)), grid=GRID))
    for frame in frames:
        assert frame.world_T_grid == SE2(pytest.approx(10.0), pytest.approx(20.0), 0.0)
        np.testing.assert_allclose(frame.origins, [[0.05, 0.0]], atol=1e-6)
        np.testing.assert_allclose(frame.points, [[0.1, 3.1]], atol=1e-6)


def test_the_window_follows_a_sensor_by_whole_cells_and_never_rotates(write, scan) -> None:
    wall_x = 4.1
    poses = [SE2(0.07 * k, -0.05 * k, 0.1 * k) for k in range(12)]
    beams = [one_beam(scan(k), wall_x - pose.x, world_T_sensor=pose) for k, pose in enumerate(poses)]
    scans = [replace(beam, angle_min=-pose.theta) for beam, pose in zip(beams, poses, strict=True)]
    frames = list(open_stream(write(scans), grid=GRID))
    for frame, pose in zip(frames, poses, strict=True):
        window = frame.world_T_grid
        assert (window.x, window.y, window.theta) == (round(pose.x / 0.2) * 0.2, round(pose.y / 0.2) * 0.2, 0.0)
        np.testing.assert_allclose(frame.origins, [[pose.x - window.x, pose.y - window.y]], atol=1e-6)
        (row,), (column,) = np.nonzero(frame.occupied)
        assert column == 30 + math.floor((wall_x - window.x) / 0.2), "the wall stays at its place in the world"
        assert row == 30 + math.floor((pose.y - window.y) / 0.2)
    assert {bool(shift_between(a.world_T_grid, b.world_T_grid, 0.2)) for a, b in pairwise(frames)} == {True, False}


def test_a_stretch_that_starts_in_a_gap_has_the_window_of_the_last_scan(write, scan) -> None:
    path = write(scan(k, pose=SE2(0.5 * k)) for k in range(40) if not 10 <= k < 20)
    whole = digests(open_stream(path, grid=GRID))
    assert digests(open_stream(f"{path}@1.5s-", grid=GRID)) == whole[15:]


def test_reference_poses_place_the_window_of_a_frame_and_change_no_frame(
    write, scan, monkeypatch: pytest.MonkeyPatch
) -> None:
    stream = open_stream(write(scan(k, pose=SE2(0.07 * k)) for k in range(12)), grid=GRID)
    frames = digests(stream)
    scans = [replace(s, reference_T_sensor=SE2(5.0, 1.0, 0.3) @ s.world_T_sensor) for s in stream.recording.scans()]
    monkeypatch.setattr(stream.recording, "scans", lambda *_: iter(scans))
    observations = list(stream.observations())
    assert digests(observation.frame for observation in observations) == frames
    for observation in observations:
        assert same_pose(observation.reference_T_grid, SE2(5.0, 1.0, 0.3) @ observation.frame.world_T_grid)
        elsewhere = replace(observation, frame=replace(observation.frame, world_T_grid=SE2(9.0)))
        again = elsewhere.seen_in(observation.reference_T_grid, GRID).frame
        assert np.count_nonzero(again.visible != observation.frame.visible) < 5, "equal up to rounding"


def test_marked_cells_stay_at_their_place_in_the_world_in_another_window() -> None:
    grid, own = GridSpec(5, 0.2), SE2(2.0, 0.0, 0.5)
    marked = np.zeros((1, 5, 5), np.bool_)
    marked[0, 1, 3] = marked[0, 4, 0] = True

    def in_window(of_own: SE2) -> list[list[int]]:
        found: list[list[int]] = np.argwhere(cells_in_window(marked, own, own @ of_own, grid)[0]).tolist()
        return found

    assert in_window(SE2(0.4, -0.2)) == [[2, 1]], "two columns on, one row back; the other cell has left"
    for nearly in (SE2(0.45, -0.15), SE2(0.4, -0.2, 0.05)):
        assert in_window(nearly) == [[2, 1]], "the cell that has the centre"


def test_points_are_returns_or_centres_of_occupied_cells(write, scan) -> None:
    path = write([scan(0), scan(1)])
    (raw, *_), (centres, *_) = open_stream(path, grid=GRID, points="raw"), open_stream(path, grid=GRID)
    np.testing.assert_array_equal(raw.occupied, centres.occupied)
    returned = np.isfinite(scan(0).ranges)
    angles = (-1.5 + 3.0 / 35 * np.arange(36))[returned]
    expected = scan(0).ranges[returned, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    np.testing.assert_allclose(raw.points, expected, atol=1e-5)
    np.testing.assert_array_equal(centres.points, GRID.cell_centres(centres.occupied))
    assert len(centres.point_origin) == len(centres.points) == centres.occupied.sum()


def test_a_digest_changes_with_every_part_of_a_frame(write, scan) -> None:
    (frame,) = open_stream(write([scan(0)]), rate_hz=10.0)

    def changed(**fields: object) -> GridFrame:
        return replace(frame, **fields)

    flipped = frame.visible.copy()
    flipped[0, 0] ^= True
    others = [
        changed(stamp_ns=frame.stamp_ns + 1),
        changed(visible=flipped),
        changed(occupied=flipped),
        changed(world_T_grid=SE2(1e-12, 0.0, 0.0)),
        changed(origins=frame.origins + np.float32(1e-3)),
        changed(points=frame.points[1:], point_origin=frame.point_origin[1:]),
        changed(point_origin=frame.point_origin + np.uint8(1)),
    ]
    digests = {frame_digest(f) for f in [frame, *others]}
    assert len(digests) == 1 + len(others)
    assert all(len(d) == 32 for d in digests)
    assert frame_digest(replace(frame, visible=frame.visible.copy())) == frame_digest(frame)


def test_the_demo_recording_has_its_known_frames() -> None:
    stream = open_stream(f"{packaged_recording('leg_tracker')}@test")
    assert (str(stream.grid), stream.period_s, stream.site) == ("100x0.1@-2,-4.5", 0.1, "leg_tracker")
    assert (len(stream), stream.gaps) == (360, 0)
    frame = next(iter(stream))
    assert not frame.visible[:, :19].any(), "nothing is seen behind a laser that looks along x"
    wall = frame.occupied[90:100, 20:35]
    assert wall.any(axis=0).mean() > 0.8, "there is a wall to the left, at y = 5 m"
    assert isinstance(GridStream(stream.recording, (0.0, 75.0)), GridStream)


def moving(scan, rest: range) -> list[Scan]:
    """Forty seconds of a sensor that moves, except for scans in `rest`, where it trembles."""
    x, scans = 0.0, []
    for k in range(400):
        x += 0.0 if k in rest else 0.1
        scans.append(scan(k, pose=SE2(x + 1e-4 * (k % 3))))
    return scans


def test_the_first_motion_of_the_window_is_known(write, scan) -> None:
    path = write(moving(scan, range(100, 300)))
    assert open_stream(f"{path}@5s-30s").first_move_s == pytest.approx(5.2)
    assert open_stream(f"{path}@10.1s-29.7s").first_move_s is None


def test_the_error_for_a_moving_sensor_suggests_a_stretch_at_rest(write, scan) -> None:
    path = write(moving(scan, range(100, 300)))
    hint = (
        r"made\.mcap@5s-30s: the sensor moves at 5\.200 s, and 'mine' follows only a sensor at rest \(moving_sensor is"
        r" false\): name a stretch in which it is at rest, such as .*made\.mcap@(\S+)$"
    )
    with pytest.raises(RecordingError, match=hint) as error:
        refuse_moving(open_stream(f"{path}@5s-30s"), "mine")
    refuse_moving(open_stream(f"{path}@{str(error.value).rpartition('@')[2]}"), "mine")


def test_no_stretch_is_suggested_if_the_sensor_is_never_at_rest(write, scan) -> None:
    path = write(moving(scan, range(100, 150)))
    with pytest.raises(RecordingError, match=r"moves at 0\.100 s, .*, and this one is at rest nowhere for 10 s$"):
        refuse_moving(open_stream(path), "mine")


def labelled(scan: Scan, label: int) -> Scan:
    return replace(scan, labels=np.full(scan.ranges.size, label, np.uint8))


def test_frames_have_the_class_of_every_occupied_cell(write, scan) -> None:
    scans = [labelled(scan(k), k % 2) if k < 6 else scan(k) for k in range(9)]
    stream = open_stream(write(scans, classes=["car", "wall"]))
    found = list(stream.labelled())
    assert [frame_digest(item.frame) for item in found] == digests(stream)
    for k, (frame, cells, labels) in enumerate(found):
        assert cells.tolist() == (np.flatnonzero(frame.occupied).tolist() if k < 6 else [])
        assert set(labels.tolist()) == ({k % 2} if k < 6 else set())
        assert labels.dtype == np.uint8


def test_cells_of_beams_without_a_label_have_no_class(write, scan) -> None:
    half = labelled(scan(0), 0)
    half.labels[: half.labels.size // 2] = 255
    frame, cells, _ = next(open_stream(write([half, scan(1)], classes=["car"])).labelled())
    assert 0 < cells.size < frame.occupied.sum()


def test_a_label_without_a_class_is_an_error_with_its_time(write, scan) -> None:
    path = write([labelled(scan(k), 7) if k == 25 else scan(k) for k in range(40)], classes=["car"])
    with pytest.raises(RecordingError, match=r"a label is class 7 at 2\.500 s, but the recording has 1 classes"):
        list(open_stream(f"{path}@2s-", grid=GRID).labelled())


@pytest.mark.parametrize(("range_max", "cells"), [(5.6, 56), (30.0, 100), (0.5, 20), (9.99, 100)])
def test_the_default_window_is_as_large_as_the_laser_measures_in_the_usual_cells(write, scan, range_max, cells) -> None:
    path = write(replace(scan(k), range_max=range_max) for k in range(30))
    grid = open_stream(path).grid
    assert (grid.size, grid.cell_m) == (cells, 0.2)


def test_a_gap_of_a_century_before_a_stretch_costs_no_memory(write, scan) -> None:
    """Of a moving sensor: the last scan before the stretch is not looked for across the gap."""
    later = 100 * 365 * 24 * 3600 * 10
    moved = [replace(scan(i), world_T_sensor=SE2(0.01 * i, 0.0, 0.0)) for i in (*range(9), *range(later, later + 9))]
    start_s = later / 10
    assert len(list(GridStream(open_recording(write(moved)), (start_s, None)))) == 9
