"""A grid stream has the same regular frames for every reader: slices of one whole, in the frame of the first sensor."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gridtrack.common.errors import GridtrackError, RecordingError
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.common.raycast import cast_scan
from gridtrack.common.scan import Scan
from gridtrack.evaluation.scoring.motion import ObservedMotion
from gridtrack.evaluation.scoring.referee import Delivery
from gridtrack.recordings import open_recording, packaged_recording
from gridtrack.recordings.stream import GridStream, frame_digest, open_stream, parse_stretch

GRID = GridSpec(60, 0.2)


def one_beam(scan: Scan, distance: float, **changes: object) -> Scan:
    """A scan with one return, straight ahead."""
    return replace(scan, ranges=np.array([distance], np.float32), angle_min=0.0, angle_increment=0.0, **changes)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("demo.mcap", ("demo.mcap", None)),
        ("demo.mcap@30s-90s", ("demo.mcap", (30.0, 90.0))),
        ("demo.mcap@30-90.5", ("demo.mcap", (30.0, 90.5))),
        ("demo.mcap@90s-", ("demo.mcap", (90.0, None))),
        ("a@b/demo.mcap@test", ("a@b/demo.mcap", "test")),
        ("demo.mcap@leave-one-out", ("demo.mcap", "leave-one-out")),
    ],
)
def test_a_stretch_is_read_from_text(text: str, expected: tuple[str, object]) -> None:
    path, stretch = parse_stretch(text)
    assert (str(path), stretch) == expected


def test_a_file_with_an_at_sign_in_its_name_is_a_file(tmp_path: Path) -> None:
    path = tmp_path / "demo@home"
    path.touch()
    assert parse_stretch(str(path)) == (path, None)


@pytest.mark.parametrize("text", ["demo.mcap@", "@test", "demo.mcap@90s-30s"])
def test_an_invalid_stretch_is_refused(text: str) -> None:
    with pytest.raises(RecordingError, match=r"'.*': "):
        parse_stretch(text)


def test_frames_are_the_scans_cast_into_the_grid(write: Callable[..., Path], scan: Callable[..., Scan]) -> None:
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


def test_every_iteration_starts_at_the_first_frame(write: Callable[..., Path], scan: Callable[..., Scan]) -> None:
    stream = open_stream(write(scan(k) for k in range(12)))
    begun = iter(stream)
    next(begun)
    once = [frame_digest(f) for f in stream]
    assert once == [frame_digest(f) for f in stream]
    assert [frame_digest(f) for f in begun] == once[1:]


def test_a_stretch_is_a_slice_of_the_whole(write: Callable[..., Path], scan: Callable[..., Scan]) -> None:
    stretches = {"train": (0.0, 1.5), "validation": (1.5, 2.04), "test": (2.04, None)}
    path = write((scan(k, offset_ns=(k * 7919) % 30_000_000) for k in range(40)), stretches=stretches)
    whole = [frame_digest(f) for f in open_stream(path, rate_hz=10.0)]
    parts = [open_stream(f"{path}@{name}", rate_hz=10.0) for name in stretches]
    assert [len(p) for p in parts] == [15, 6, len(whole) - 21]
    assert [frame_digest(f) for part in parts for f in part] == whole
    assert [frame_digest(f) for f in open_stream(f"{path}@1.5s-2.04s", rate_hz=10.0)] == whole[15:21]


def test_the_stream_has_the_metadata_of_the_recording(write: Callable[..., Path], scan: Callable[..., Scan]) -> None:
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


def test_without_metadata_the_grid_is_the_default_and_the_rate_the_median(
    write: Callable[..., Path], scan: Callable[..., Scan]
) -> None:
    stream = open_stream(write(scan(k, offset_ns=-k * 300_000) for k in range(30)))
    assert stream.grid == GridSpec(100, 0.2)
    assert stream.period_s == 0.1


@pytest.mark.parametrize(
    ("stretch", "message"),
    [
        ("@tset", "no stretch 'tset'; did you mean 'test'"),
        ("@5s-9s", r"the recording is 2\.9 s long"),
        ("@3.5s-", r"the recording is 2\.9 s long"),
        ("@1.01s-1.02s", "no frame at 10 Hz"),
    ],
)
def test_a_stretch_outside_the_recording_is_refused(
    stretch: str, message: str, write: Callable[..., Path], scan: Callable[..., Scan]
) -> None:
    path = write((scan(k) for k in range(30)), stretches={"test": (1.0, None)})
    with pytest.raises(GridtrackError, match=message):
        open_stream(f"{path}{stretch}")


def test_an_invalid_rate_is_refused(write: Callable[..., Path], scan: Callable[..., Scan]) -> None:
    path = write([scan(0)])
    with pytest.raises(RecordingError, match="give one with --rate"):
        open_stream(path)
    with pytest.raises(RecordingError, match="a rate of -1 Hz"):
        open_stream(path, rate_hz=-1.0)


def test_gaps_are_counted_and_their_frames_empty(write: Callable[..., Path], scan: Callable[..., Scan]) -> None:
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


def test_the_grid_of_a_static_sensor_has_the_frame_of_the_sensor(
    write: Callable[..., Path], scan: Callable[..., Scan]
) -> None:
    pose = SE2(10.0, 20.0, math.pi / 2)
    frames = list(open_stream(write(one_beam(scan(k), 3.0, world_T_sensor=pose) for k in range(3)), grid=GRID))
    for frame in frames:
        assert (frame.world_T_grid.x, frame.world_T_grid.y) == (10.0, 20.0)
        np.testing.assert_allclose(frame.origins, [[0.0, 0.0]], atol=1e-6)
        np.testing.assert_allclose(frame.points, [[3.1, 0.1]], atol=1e-6)
        np.testing.assert_allclose(frame.world_T_grid.apply(frame.points), [[9.9, 23.1]], atol=1e-5)


def test_the_grid_follows_a_sensor_that_moves(write: Callable[..., Path], scan: Callable[..., Scan]) -> None:
    scans = [one_beam(scan(k), 3.0, world_T_sensor=SE2(0.5 * k, 0.0, 0.1 * k)) for k in range(4)]
    for k, frame in enumerate(open_stream(write(scans), grid=GRID)):
        assert (frame.world_T_grid.x, frame.world_T_grid.theta) == (0.5 * k, pytest.approx(0.1 * k))
        np.testing.assert_allclose(frame.origins, [[0.0, 0.0]], atol=1e-6)
        np.testing.assert_allclose(frame.points, [[3.1, 0.1]], atol=1e-6)


def two_sensors(scan: Callable[..., Scan]) -> list[Scan]:
    """A front sensor at the origin, and 2 m behind it one that faces backwards; each has one return at 1.1 m."""
    scans = []
    for k in range(5):
        scans.append(one_beam(scan(k, "front"), 1.1))
        back = SE2(-2.0, 0.0, math.pi)
        scans.append(one_beam(scan(k, "rear", offset_ns=1), 1.1, world_T_sensor=back))
    return scans


def test_several_sensors_share_the_frame_of_the_first(write: Callable[..., Path], scan: Callable[..., Scan]) -> None:
    path = write(two_sensors(scan))
    for points in ("centres", "raw"):
        for frame in open_stream(path, grid=GRID, points=points, rate_hz=10.0):
            np.testing.assert_allclose(frame.origins, [[0.0, 0.0], [-2.0, 0.0]], atol=1e-6)
            order = np.argsort(frame.point_origin)
            np.testing.assert_allclose(frame.points[order][:, 0], [1.1, -3.1], atol=0.11)
            assert frame.point_origin[order].tolist() == [0, 1]
            assert frame.point_origin.dtype == np.uint8


def test_raw_points_are_the_returns_and_centres_those_of_the_occupied_cells(
    write: Callable[..., Path], scan: Callable[..., Scan]
) -> None:
    path = write([scan(0), scan(1)])
    (raw, *_), (centres, *_) = open_stream(path, grid=GRID, points="raw"), open_stream(path, grid=GRID)
    np.testing.assert_array_equal(raw.occupied, centres.occupied)
    returned = np.isfinite(scan(0).ranges)
    angles = (-1.5 + 3.0 / 35 * np.arange(36))[returned]
    expected = scan(0).ranges[returned, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    np.testing.assert_allclose(raw.points, expected, atol=1e-5)
    np.testing.assert_array_equal(centres.points, GRID.cell_centres(centres.occupied))
    assert len(centres.point_origin) == len(centres.points) == centres.occupied.sum()


def test_a_digest_changes_with_every_part_of_a_frame(write: Callable[..., Path], scan: Callable[..., Scan]) -> None:
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


def test_several_sensors_without_known_mounting_are_refused_with_the_topics(
    write: Callable[..., Path], scan: Callable[..., Scan]
) -> None:
    path = write([scan(k, sensor) for k in range(5) for sensor in ("front", "rear")])
    with pytest.raises(
        RecordingError,
        match=r"several sensors \(front, rear\).*import one of them.*--topic /scan/front`, or --topic /scan/rear",
    ):
        open_stream(path)
    assert len(open_stream(path, topic="/scan/rear")) == 5
    assert "several sensors (front, rear)" in open_recording(path).overview().warnings[0]


def moving(scan: Callable[..., Scan], rest: range) -> list[Scan]:
    """Forty seconds of a sensor that moves except while its scan is in `rest`, where it trembles."""
    x, scans = 0.0, []
    for k in range(400):
        x += 0.0 if k in rest else 0.1
        scans.append(scan(k, pose=SE2(x + 1e-4 * (k % 3))))
    return scans


def delivery(text: str | Path) -> Delivery:
    stream = open_stream(text)
    return Delivery(stream, lambda: None, ObservedMotion(stream, np.ones(stream.grid.shape, np.bool_)))


def test_the_error_for_a_moving_sensor_has_the_time_in_the_recording_and_a_stretch_at_rest(
    write: Callable[..., Path], scan: Callable[..., Scan]
) -> None:
    path = write(moving(scan, range(100, 300)))
    hint = r"the sensor moves at 5\.100 s, and only a sensor at rest can be scored: name a stretch .*made\.mcap@(\S+)$"
    with pytest.raises(RecordingError, match=hint) as error:
        list(delivery(f"{path}@5s-30s"))
    at_rest = f"{path}@{str(error.value).rpartition('@')[2]}"
    assert len(list(delivery(at_rest))) == len(open_stream(at_rest)) > 190


def test_the_error_for_a_sensor_that_never_rests_suggests_no_stretch(
    write: Callable[..., Path], scan: Callable[..., Scan]
) -> None:
    path = write(moving(scan, range(100, 150)))
    with pytest.raises(RecordingError, match=r"moves at 0\.100 s, .*, and this one is at rest nowhere for 10 s$"):
        list(delivery(path))


def test_the_error_for_a_wrong_label_has_the_time_in_the_recording(
    write: Callable[..., Path], scan: Callable[..., Scan]
) -> None:
    labels = np.full(36, 7, np.uint8)
    path = write([replace(scan(k), labels=labels if k == 25 else None) for k in range(40)], classes=["car"])
    with pytest.raises(RecordingError, match=r"a label names class 7 at 2\.500 s"):
        list(open_stream(f"{path}@2s-", grid=GRID).labelled())
