"""Recorded occupancy grids and grid maps are the forecasts that were published, in the world of the recording."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from gridtrack.common.errors import ConfigurationError, RecordingError
from gridtrack.common.geometry import SE2, same_pose
from gridtrack.recordings.frames.transform import SE3
from gridtrack.recordings.outputs.conversion import write_outputs

from scenes import drive_bag as made
from scenes.command_line import gridtrack
from scenes.output_bag import DELAY_MS, Outputs, laser_link, write_bag

ROS1, ROS2 = made.Ros(1), made.Ros(2)
NOW = np.array([[0, 20, -1, 100], [50, 0, 0, 0], [0, 0, 0, 30]])
LATER = NOW[::-1]
TWO = ("/pred_05=0.5s", "/pred_10=1s")


def probabilities(percent: np.ndarray) -> np.ndarray:
    return np.where(percent < 0, np.nan, percent / 100)


def refusal(tmp_path: Path, *messages: made.Message, grid: tuple[str, ...] = TWO, ros: made.Ros = ROS2) -> str:
    with pytest.raises((RecordingError, ConfigurationError)) as refused:
        write_outputs(write_bag(tmp_path, ros, *messages), tmp_path / "mine.npz", grid=grid)
    assert not list(tmp_path.glob("*.npz*"))
    return str(refused.value)


@pytest.mark.parametrize("ros", [ROS1, ROS2])
def test_two_topics_are_joined_by_their_stamps(tmp_path: Path, ros: made.Ros) -> None:
    out, origin = Outputs(ros), SE2(-1.0, -2.0)
    bag = write_bag(
        tmp_path,
        ros,
        out.grid("/pred_05", 500, NOW, origin),
        out.grid("/pred_10", 500, LATER, origin, delay_ms=70),
        out.grid("/pred_05", 700, LATER, origin),
    )
    forecasts, lines = write_outputs(bag, tmp_path / "mine.npz", grid=TWO[::-1])
    assert (len(forecasts), forecasts.shape, forecasts.cell_m) == (2, (3, 4), 0.5)
    assert forecasts.lead_s.tolist() == [0.5, 1.0]
    assert (forecasts.stamp_ns - made.START_NS).tolist() == [500 * made.MS, 700 * made.MS]
    assert (forecasts.available_ns - forecasts.stamp_ns).tolist() == [70 * made.MS, DELAY_MS * made.MS]
    assert_allclose(forecasts.occupancy(0, 0), probabilities(NOW), atol=1e-3)
    assert_allclose(forecasts.occupancy(0, 1), probabilities(LATER), atol=1e-3)
    assert_allclose(forecasts.occupancy(1, 0), probabilities(LATER), atol=1e-3)
    assert np.isnan(forecasts.occupancy(1, 1)).all()
    assert same_pose(forecasts.world_T_grid(0, 1), origin)
    assert any("of 2 stamps these have a grid: /pred_05 2, /pred_10 1" in line for line in lines)


def test_a_grid_that_is_turned_on_a_moving_robot_has_its_pose_in_the_world(tmp_path: Path) -> None:
    out, origin = Outputs(ROS1), SE2(0.5, -1.0, 0.7)
    messages = [
        *made.two_scanner_drive(ROS1, made.DURATION_MS),
        *(out.grid("/costmap", at, NOW, origin, frame="base_link") for at in (500, 1500)),
        *(out.grid("/in_map", at, NOW, SE2(1.0, 2.0), frame="/map") for at in (500, 1500)),
    ]
    bag = ROS1.write(tmp_path / "a.bag", messages)
    forecasts, _ = write_outputs(bag, tmp_path / "mine.npz", grid=("/costmap=0s", "/in_map=1s"))
    for n, at_ms in enumerate((500, 1500)):
        assert same_pose(forecasts.world_T_grid(n, 0), made.robot_at(at_ms) @ origin)
        # map_T_odom goes from 0 to 0.5 m in the first second, and back in the next one
        assert same_pose(forecasts.world_T_grid(n, 1), SE2(1.0 - 0.25, 2.0))


@pytest.mark.parametrize("ros", [ROS1, ROS2])
def test_a_grid_map_is_unrolled_and_turned_to_our_axes(tmp_path: Path, ros: made.Ros) -> None:
    # by hand: 3 cells along x, 4 along y; in space, x to the right and y up, row 0 lowest
    space = np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6], [0.7, 0.8, np.nan], [0.0, 1.0, 0.9]], np.float32)
    # a grid map's row is along -x, its column along -y, from the corner of greatest x and y
    unrolled = np.array([[0.9, np.nan, 0.6, 0.3], [1.0, 0.8, 0.5, 0.2], [0.0, 0.7, 0.4, 0.1]], np.float32)
    # the buffer begins at row 2, column 1: its row 2 is the first one in space
    buffer = np.empty((3, 4), np.float32)
    for row in range(3):
        for column in range(4):
            buffer[(row + 2) % 3, (column + 1) % 4] = unrolled[row, column]
    message = Outputs(ros).grid_map(500, buffer, (2, 1), SE2(10.0, 20.0))
    forecasts, _ = write_outputs(write_bag(tmp_path, ros, message), tmp_path / "mine.npz", grid=("/map:p=0.5s",))
    assert_allclose(forecasts.occupancy(0, 0), space, atol=1e-3)
    assert same_pose(forecasts.world_T_grid(0, 0), SE2(10.0 - 0.75, 20.0 - 1.0))


def test_a_layer_that_is_missing_or_no_probability_is_refused(tmp_path: Path) -> None:
    message = Outputs(ROS2).grid_map(500, np.zeros((3, 4), np.float32), (0, 0), SE2())
    bag = write_bag(tmp_path, ROS2, message)
    with pytest.raises(RecordingError, match="/map has no layer 'q'; its layers: elevation, p"):
        write_outputs(bag, tmp_path / "mine.npz", grid=("/map:q=0s",))
    with pytest.raises(RecordingError, match="/map:elevation has values from 7 to 7: expected 0 to 1"):
        write_outputs(bag, tmp_path / "mine.npz", grid=("/map:elevation=0s",))
    with pytest.raises(RecordingError, match="'/map' is grid_map_msgs/msg/GridMap; expected nav_msgs"):
        write_outputs(bag, tmp_path / "mine.npz", grid=("/map=0s",))


def test_grids_of_different_sizes_are_refused_in_one_line(tmp_path: Path) -> None:
    out = Outputs(ROS2)
    error = refusal(tmp_path, out.grid("/pred_05", 500, NOW, SE2()), out.grid("/pred_10", 500, NOW[:2], SE2()))
    assert "/pred_10 has 2 x 4 cells of 0.5 m, and /pred_05 3 x 4 cells of 0.5 m: forecasts need one size" in error


def test_a_topic_or_frame_that_is_unknown_names_the_remedy(tmp_path: Path) -> None:
    messages = [
        Outputs(ROS2).grid("/pred_05", 500, NOW, SE2()),
        Outputs(ROS2).grid("/pred_10", 500, NOW, SE2(), frame="map"),
    ]
    bag = write_bag(tmp_path, ROS2, *messages)
    with pytest.raises(RecordingError, match="no message on '/prde_05'; did you mean '/pred_05'"):
        write_outputs(bag, tmp_path / "mine.npz", grid=("/prde_05=1s",))
    with pytest.raises(RecordingError, match="/pred_10 is in frame 'map', which no transform joins to 'front_laser'"):
        write_outputs(bag, tmp_path / "mine.npz", grid=TWO)
    with pytest.raises(RecordingError, match="expected nav_msgs/msg/OccupancyGrid"):
        write_outputs(bag, tmp_path / "mine.npz", grid=("/front_scan=1s",))


def test_a_frame_above_the_laser_is_resolved(tmp_path: Path) -> None:
    pose = SE2(2.0, 1.0, math.pi / 2)
    grid = Outputs(ROS2).grid("/pred_05", 500, NOW, SE2(), frame="hall")
    bag = write_bag(tmp_path, ROS2, laser_link(ROS2, "hall", pose), grid)
    forecasts, _ = write_outputs(bag, tmp_path / "mine.npz", grid=TWO[:1])
    assert same_pose(forecasts.world_T_grid(0, 0), SE2()), "the topmost common frame, hall, is the world"


def test_a_frame_whose_transforms_end_is_left_out(tmp_path: Path) -> None:
    moving = [
        ROS2.transforms(at, ("front_laser", "camera", SE3.in_plane(SE2(at / 1000)))) for at in range(0, 1000, 100)
    ]
    grids = [Outputs(ROS2).grid("/pred_05", at, NOW, SE2(), frame="camera") for at in (250, 1850, 1950)]
    bag = write_bag(tmp_path, ROS2, *moving, *grids)
    forecasts, lines = write_outputs(bag, tmp_path / "mine.npz", grid=TWO[:1])
    assert same_pose(forecasts.world_T_grid(0, 0), SE2(0.25))
    assert same_pose(forecasts.world_T_grid(1, 0), SE2(0.9)), "within a second of the last transform it is used"
    assert len(forecasts) == 2
    assert any("without transforms of 'camera' within 1 s of their stamps: 1 of them" in line for line in lines)


def test_headers_without_a_stamp_take_the_time_of_recording(tmp_path: Path) -> None:
    message = Outputs(ROS2).grid("/pred_05", 500, NOW, SE2())
    message[3].header.stamp.sec = message[3].header.stamp.nanosec = 0
    forecasts, lines = write_outputs(write_bag(tmp_path, ROS2, message), tmp_path / "mine.npz", grid=TWO[:1])
    assert forecasts.stamp_ns[0] == message[2] == forecasts.available_ns[0]
    assert any("stamps are zero: the time of recording is the stamp" in line for line in lines)


@pytest.mark.parametrize(
    ("delay_ms", "says", "known_after_ms"),
    [(86_400_000, "in another clock", 0), (-400, "not of the time that it predicts", 0), (200, "", 200)],
)
def test_times_of_recording_that_do_not_fit_the_stamps_are_told(tmp_path, delay_ms, says, known_after_ms) -> None:
    messages = [Outputs(ROS2).grid("/pred_05", at, NOW, SE2(), delay_ms=delay_ms) for at in range(500, 1500, 100)]
    forecasts, lines = write_outputs(write_bag(tmp_path, ROS2, *messages), tmp_path / "mine.npz", grid=TWO[:1])
    assert ((forecasts.available_ns - forecasts.stamp_ns) == known_after_ms * made.MS).all()
    told = [line for line in lines if line.startswith("/pred_05")]
    assert [says in line for line in told] == [True] * bool(says), lines


def test_a_stretch_has_its_own_forecasts_alone(tmp_path: Path) -> None:
    messages = [Outputs(ROS2).grid("/pred_05", at, NOW, SE2()) for at in range(0, 2000, 100)]
    bag = write_bag(tmp_path, ROS2, *messages)
    forecasts, _ = write_outputs(f"{bag}@0.5s-1s", tmp_path / "mine.npz", grid=TWO[:1])
    assert (forecasts.stamp_ns - made.START_NS).tolist() == [at * made.MS for at in range(500, 1000, 100)]


# ---- hostile messages


@pytest.mark.parametrize(
    ("info", "says"),
    [
        ({"width": 2**32 - 1, "height": 2**32 - 1}, "4294967295 x 4294967295 cells and 12 values"),
        ({"width": 0}, "3 x 0 cells and 12 values"),
        ({"resolution": math.nan}, "a cell of nan m"),
        ({"resolution": -0.5}, "a cell of -0.5 m"),
    ],
)
def test_impossible_sizes_are_left_out(tmp_path: Path, info: dict, says: str) -> None:
    good = Outputs(ROS2).grid("/pred_05", 500, NOW, SE2())
    bad = Outputs(ROS2).grid("/pred_05", 700, NOW, SE2(), **info)
    forecasts, lines = write_outputs(write_bag(tmp_path, ROS2, good, bad), tmp_path / "mine.npz", grid=TWO[:1])
    assert len(forecasts) == 1
    assert any(says in line and "1 of them" in line for line in lines)


def test_a_pose_that_is_not_finite_and_a_cut_message_are_left_out(tmp_path: Path) -> None:
    out = Outputs(ROS1)
    nowhere = out.grid("/pred_05", 700, NOW, SE2())
    nowhere[3].info.origin.position.x = math.nan
    tilted = out.grid("/pred_05", 800, NOW, SE2())
    tilted[3].info.origin.orientation.x = tilted[3].info.origin.orientation.w = math.sqrt(0.5)
    bag = write_bag(tmp_path, ROS1, out.grid("/pred_05", 500, NOW, SE2()), nowhere, tilted)
    content = bag.read_bytes()
    forecasts, lines = write_outputs(bag, tmp_path / "mine.npz", grid=TWO[:1])
    assert len(forecasts) == 1
    assert any("not finite, tilted or upside down: 2 of them" in line for line in lines)
    size = content.index(np.array(NOW, np.int8).tobytes()) - 4
    bag.write_bytes(content[:size] + (2**31).to_bytes(4, "little") + content[size + 4 :])
    with pytest.raises(RecordingError, match="cannot be decoded as nav_msgs/msg/OccupancyGrid: 1 of them"):
        write_outputs(bag, tmp_path / "mine.npz", grid=TWO[:1], overwrite=True)


def test_values_that_are_no_percentages_are_refused(tmp_path: Path) -> None:
    message = Outputs(ROS2).grid("/pred_05", 500, NOW + (NOW == 100) * 20, SE2())
    assert "/pred_05 has the value 120: expected percentages, or -1 for unknown" in refusal(
        tmp_path, message, grid=TWO[:1]
    )


def test_more_than_the_limit_is_refused_before_it_is_written(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("gridtrack.recordings.outputs.grids.MAX_OUTPUT_BYTES", 20)
    message = Outputs(ROS2).grid("/pred_05", 500, NOW, SE2())
    assert "are more than 8 GiB: name a part" in refusal(tmp_path, message, grid=TWO[:1])


# ---- the command


def test_the_command_writes_the_file_and_one_line(tmp_path: Path) -> None:
    bag = write_bag(tmp_path, ROS2, Outputs(ROS2).grid("/pred_05", 500, NOW, SE2()))
    words = ("recording", "outputs", bag, "--grid", "/pred_05=0.5s", "--out", tmp_path / "mine.npz")
    assert "mine.npz: 1 forecasts 0.5 to 0.5 s ahead (1 times), 3 x 4 cells of 0.5 m" in gridtrack(*words).stdout
    assert "exists already; name another file, or replace it with --overwrite" in gridtrack(*words, code=2).stderr


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ((), "name the outputs with --grid TOPIC=SECONDS, or with --objects TOPIC (one of both)"),
        (("--grid", "/a"), "--grid /a: expected TOPIC=SECONDS, as in /pred_05=0.5s"),
        (("--grid", "/a=soon"), "'soon': expected seconds"),
        (("--grid", "/a=-1s"), "expected 0 to 60 seconds ahead"),
        (("--grid", "/a=1s", "--grid", "/b=1s"), "two topics for one time ahead"),
        (("--grid", "/a=1s", "--objects", "/b"), "one of both"),
        (("--objects", "/a", "--width", "wide"), "'wide': expected metres"),
        (("--objects", "/a", "--twist-frame", "map"), "--twist-frame map: it should be 'object' or 'world'"),
    ],
)
def test_wrong_options_are_one_line(tmp_path: Path, options: tuple[str, ...], says: str) -> None:
    bag = write_bag(tmp_path, ROS2)
    done = gridtrack("recording", "outputs", bag, "--out", tmp_path / "mine.npz", *options, code=2)
    assert says in done.stderr
    assert done.stderr.count("\n") == 1
