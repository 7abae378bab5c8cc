"""Recorded objects become the cells that their outlines pass through, over the static map, at each time ahead."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import polars
import pytest
from numpy.testing import assert_allclose
from numpy.typing import NDArray

from gridtrack.common.errors import RecordingError
from gridtrack.common.forecast_file import ForecastFile
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec
from gridtrack.common.scene import Scene, SceneObject
from gridtrack.recordings.outputs.conversion import write_outputs
from gridtrack.recordings.outputs.object_table import PredictedPath, RecordedObject, outline_of
from gridtrack.recordings.outputs.rasterise import StaticMap, blur, draw_object, poses_at
from gridtrack.recordings.stream import open_stream
from gridtrack.recordings.truth import OUTLINE, truth_grid

from scenes import drive_bag as made
from scenes.output_bag import DELAY_MS, FRAME, Outputs, box_cells, laser_link, write_bag

ROS1, ROS2 = made.Ros(1), made.Ros(2)
CELL_M, SIZE = 0.2, 100
TURNED = SE2(3.1, 1.1, math.pi / 2)
SHARP = {"objects": "/objects", "width_m": 0.0, "horizon_s": 1.0}


def occupied(forecasts: ForecastFile, lead_s: float, n: int = 0) -> NDArray[np.bool_]:
    """The certain cells at one time ahead; no other cell may have a probability."""
    planes = forecasts.occupancy(n, int(np.argmin(np.abs(forecasts.lead_s - lead_s))))
    assert set(np.unique(planes)) <= {0.0, 1.0}
    return planes > 0.0


def wall(bag: Path) -> NDArray[np.bool_]:
    return next(iter(open_stream(bag))).occupied


def test_a_car_moves_by_its_twist_in_its_own_frame_over_the_static_map(tmp_path: Path) -> None:
    out = Outputs(ROS2)
    bag = write_bag(tmp_path, ROS2, out.objects(1000, out.car(TURNED, (2.0, 0.0))))
    forecasts, _ = write_outputs(bag, tmp_path / "mine.npz", **SHARP)
    assert forecasts.note == "objects + constant velocity"
    assert_allclose(forecasts.lead_s, np.arange(11) * 0.1)
    assert forecasts.stamp_ns[0] - made.START_NS == 1000 * made.MS
    assert forecasts.available_ns[0] - forecasts.stamp_ns[0] == DELAY_MS * made.MS
    corner = forecasts.world_T_grid(0, 0)
    assert (corner.x, corner.y, forecasts.cell_m, forecasts.shape) == (-10.0, -10.0, CELL_M, (SIZE, SIZE))
    for lead_s in (0.0, 0.5, 1.0):
        ahead = box_cells((2.1, 4.1), (-0.9 + 2 * lead_s, 3.1 + 2 * lead_s), CELL_M, SIZE)
        np.testing.assert_array_equal(occupied(forecasts, lead_s), ahead | wall(bag))
    forecasts, _ = write_outputs(bag, tmp_path / "other.npz", **SHARP, twist_frame="world")
    ahead = box_cells((4.1, 6.1), (-0.9, 3.1), CELL_M, SIZE)
    np.testing.assert_array_equal(occupied(forecasts, 1.0), ahead | wall(bag))


@pytest.mark.parametrize("package", ["autoware_perception_msgs", "autoware_auto_perception_msgs"])
def test_a_tracked_car_is_read_as_a_predicted_one(tmp_path: Path, package: str) -> None:
    out = Outputs(ROS2)
    car = out.car(TURNED, (2.0, 0.0), kind=f"{package}/msg/TrackedObject")
    forecasts, _ = write_outputs(write_bag(tmp_path, ROS2, out.objects(1000, car)), tmp_path / "mine.npz", **SHARP)
    ahead = box_cells((2.1, 4.1), (1.1, 5.1), CELL_M, SIZE)
    np.testing.assert_array_equal(occupied(forecasts, 1.0), ahead | wall(tmp_path / "bag"))


def test_predicted_paths_have_their_probabilities(tmp_path: Path) -> None:
    out = Outputs(ROS2)
    left = [TURNED, SE2(2.1, 1.1, math.pi / 2), SE2(1.1, 1.1, math.pi / 2)]
    stays = [TURNED, TURNED]
    bag = write_bag(tmp_path, ROS2, out.objects(1000, out.car(TURNED, (2.0, 0.0), paths=((0.6, left), (0.2, stays)))))
    forecasts, _ = write_outputs(bag, tmp_path / "mine.npz", **SHARP)
    assert forecasts.note == "objects + predicted paths"
    moved, stayed = (box_cells((x, x + 2.0), (-0.9, 3.1), CELL_M, SIZE) for x in (0.1, 2.1))
    expected = np.where(wall(bag), 1.0, 0.75 * moved + 0.25 * stayed)
    assert_allclose(forecasts.occupancy(0, 10), expected, atol=0.003)


def test_existence_multiplies_and_zero_everywhere_is_not_filled_in(tmp_path: Path) -> None:
    out = Outputs(ROS2)
    maybe = write_bag(tmp_path, ROS2, out.objects(1000, out.car(TURNED, (0.0, 0.0), existence=0.4)))
    forecasts, _ = write_outputs(maybe, tmp_path / "mine.npz", **SHARP)
    assert_allclose(np.unique(forecasts.occupancy(0, 0)), [0.0, 0.4, 1.0], atol=1e-6)
    other = tmp_path / "other"
    other.mkdir()
    empty = write_bag(other, ROS2, out.objects(1000, out.car(TURNED, (0.0, 0.0), existence=0.0)))
    forecasts, lines = write_outputs(empty, tmp_path / "zero.npz", **SHARP)
    assert any("existence is 0 for all objects" in line for line in lines)
    assert forecasts.occupancy(0, 0)[box_cells((2.1, 4.1), (-0.9, 3.1), CELL_M, SIZE)].min() == 1.0


@pytest.mark.parametrize("speed", [2.0, 0.0])
def test_velocities_in_the_other_frame_are_told(tmp_path: Path, speed: float) -> None:
    out = Outputs(ROS2)
    # drives along y, and its twist is in the frame of the header
    messages = [
        out.objects(
            at, *(out.car(SE2(3.1, speed * at / 1000 - k, math.pi / 2), (0.0, speed), number=k) for k in (1, 2))
        )
        for at in range(0, 2000, 50)
    ]
    bag = write_bag(tmp_path, ROS2, *messages)
    _, lines = write_outputs(bag, tmp_path / "mine.npz", **SHARP)
    told = [line for line in lines if "--twist-frame" in line]
    assert len(told) == (speed > 0)
    if told:
        assert "90 degrees off the motion of their tracks in the frame 'object', and 0 in 'world'" in told[0]
    _, lines = write_outputs(bag, tmp_path / "other.npz", **SHARP, twist_frame="world")
    assert not any("--twist-frame" in line for line in lines)


def test_people_without_velocities_go_on_as_they_walked(tmp_path: Path) -> None:
    out = Outputs(ROS1)
    walk = [out.leg_trackers(at, (4, 2.1 + at / 1000, 0.1)) for at in range(0, 1100, 100)]
    bag = write_bag(tmp_path, ROS1, *walk)
    forecasts, _ = write_outputs(bag, tmp_path / "mine.npz", **{**SHARP, "objects": "/people"})
    person = np.argwhere(occupied(forecasts, 1.0, n=10) & ~wall(bag))
    centre = (person.min(axis=0) + person.max(axis=0) + 1) / 2 * CELL_M - 10
    assert_allclose(centre, [0.1, 4.1], atol=CELL_M / 2)  # y, x
    first = np.argwhere(occupied(forecasts, 1.0) & ~wall(bag))
    assert_allclose((first.min(axis=0) + first.max(axis=0) + 1) / 2 * CELL_M - 10, [0.1, 2.1], atol=CELL_M / 2)


@pytest.mark.parametrize("ros", [ROS1, ROS2])
def test_every_type_of_message_gives_its_objects(tmp_path: Path, ros: made.Ros) -> None:
    out, header = Outputs(ros), ros.header(1000, FRAME)

    def point(x: float, y: float) -> object:
        return ros.make("geometry_msgs/msg/Point", x=x, y=y)

    at = ros.make("geometry_msgs/msg/PoseWithCovariance", pose=out.pose(SE2(2.1, 1.1)))
    spencer = ros.make("spencer_tracking_msgs/msg/TrackedPerson", track_id=3, is_matched=True, pose=at)
    person = ros.make("people_msgs/msg/Person", name="a", position=point(2.1, 1.1), reliability=1.0)
    circle = ros.make("obstacle_detector/msg/CircleObstacle", center=point(2.1, 1.1), radius=0.9, true_radius=0.25)
    ends = {"first_point": point(-3.1, 2.1), "last_point": point(-3.1, 3.1)}
    segment = ros.make("obstacle_detector/msg/SegmentObstacle", **ends)
    box = ros.make("vision_msgs/msg/BoundingBox3D", center=out.pose(SE2(2.1, 1.1)))
    found: dict[str, Any] = {"id": 1, "score": 1.0}
    if ros is ROS2:
        found = {"hypothesis": ros.make("vision_msgs/msg/ObjectHypothesis", class_id="person", score=1.0)}
    result = ros.make("vision_msgs/msg/ObjectHypothesisWithPose", pose=at, **found)
    detected = ros.make("vision_msgs/msg/Detection3D", header=header, results=[result], bbox=box)
    messages = {
        "/spencer": ("spencer_tracking_msgs/msg/TrackedPersons", {"tracks": [spencer]}),
        "/persons": ("people_msgs/msg/People", {"people": [person]}),
        "/obstacles": ("obstacle_detector/msg/Obstacles", {"segments": [segment], "circles": [circle]}),
        "/boxes": ("vision_msgs/msg/Detection3DArray", {"detections": [detected]}),
    }
    bag = write_bag(
        tmp_path, ros, *(out.message(t, kind, 1000, header=header, **fields) for t, (kind, fields) in messages.items())
    )
    around = box_cells((1.85, 2.35), (0.85, 1.35), CELL_M, SIZE)
    for number, topic in enumerate(messages):
        forecasts, lines = write_outputs(bag, tmp_path / f"{number}.npz", **{**SHARP, "objects": topic})
        found = occupied(forecasts, 1.0) & ~wall(bag)
        if topic == "/obstacles":
            line = box_cells((-3.1, -3.1), (2.1, 3.1), CELL_M, SIZE)
            assert (found & line).sum() == line.sum() == 6
            found &= ~line
        assert found.any()
        assert not (found & ~around).any(), lines


def test_objects_in_another_frame_are_turned_to_the_world(tmp_path: Path) -> None:
    out = Outputs(ROS2)
    # the laser looks along y of the hall, the world; the car is in the laser's frame
    link = laser_link(ROS2, "hall", SE2(0.0, 0.0, math.pi / 2))
    bag = write_bag(tmp_path, ROS2, link, out.objects(1000, out.car(SE2(1.1, -3.1, 0.0), (2.0, 0.0))))
    forecasts, _ = write_outputs(bag, tmp_path / "mine.npz", **SHARP)
    ahead = box_cells((2.1, 4.1), (-0.9 + 2.0, 3.1 + 2.0), CELL_M, SIZE)
    np.testing.assert_array_equal(occupied(forecasts, 1.0), ahead | wall(bag))


def test_the_window_follows_a_robot_that_moves(tmp_path: Path) -> None:
    out, place = Outputs(ROS2), SE2(3.1, 0.1)
    seen = {at: out.car(made.robot_at(at).inverse() @ place, (0.0, 0.0), size=(1.0, 1.0)) for at in (500, 1500, 2300)}
    messages = [out.objects(at, car, frame="base_link") for at, car in seen.items()]
    bag = ROS2.write(tmp_path / "bag", [*made.two_scanner_drive(ROS2, made.DURATION_MS), *messages])
    forecasts, _ = write_outputs(bag, tmp_path / "mine.npz", **SHARP)
    corners = {forecasts.world_T_grid(n, 0).x for n in range(3)}
    assert len(corners) == 3
    around = SE2(3.1, 0.1)
    for n in range(3):
        rows, columns = np.nonzero(forecasts.occupancy(n, 0) > 0.99)
        corner = forecasts.world_T_grid(n, 0)
        x, y = corner.x + (columns + 0.5) * CELL_M - around.x, corner.y + (rows + 0.5) * CELL_M - around.y
        near = np.maximum(np.abs(x), np.abs(y)) < 1.2
        assert 16 <= near.sum() <= 26, "the outline of a metre on a side, turned as it may be"
        assert np.hypot(x[near], y[near]).max() < 0.5 * math.sqrt(2) + CELL_M


def test_numbers_that_are_not_finite_are_left_out(tmp_path: Path) -> None:
    out = Outputs(ROS2)
    cars = [
        out.car(TURNED, (2.0, 0.0)),
        out.car(TURNED, (math.nan, 0.0)),
        out.car(TURNED, (1.0, 0.0), existence=math.inf),
        out.car(SE2(1e300, 0.0), (1.0, 0.0)),
        out.car(TURNED, (1.0, 0.0), size=(1e6, 1.0)),
    ]
    bag = write_bag(tmp_path, ROS2, out.objects(1000, *cars))
    forecasts, lines = write_outputs(bag, tmp_path / "mine.npz", **SHARP)
    np.testing.assert_array_equal(
        occupied(forecasts, 0.0), box_cells((2.1, 4.1), (-0.9, 3.1), CELL_M, SIZE) | wall(bag)
    )
    assert any("not finite or impossible: 3 of them" in line for line in lines)
    assert any("not finite, tilted or upside down: 1 of them" in line for line in lines)


def test_a_topic_without_objects_names_those_that_have_some(tmp_path: Path) -> None:
    out = Outputs(ROS2)
    bag = write_bag(tmp_path, ROS2, out.objects(1000, out.car(TURNED, (0.0, 0.0))))
    with pytest.raises(RecordingError, match="no message on '/tracks'; known: /objects"):
        write_outputs(bag, tmp_path / "mine.npz", objects="/tracks")
    with pytest.raises(
        RecordingError, match="'/front_scan' is sensor_msgs/msg/LaserScan; expected autoware_perception"
    ):
        write_outputs(bag, tmp_path / "mine.npz", objects="/front_scan")


# ---- tables

HEADER = "stamp_ns,track,x,y,yaw,vx,vy,length,width,existence,label,lead_s,path,probability\n"
STAMP_NS = made.START_NS + 1000 * made.MS


def table(tmp_path: Path, *rows: str, header: str = HEADER) -> Path:
    path = tmp_path / "objects.csv"
    path.write_text(header + "".join(f"{row}\n" for row in rows))
    return path


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_table_is_read_like_messages(tmp_path: Path, suffix: str) -> None:
    bag = write_bag(tmp_path, ROS2)
    path = table(
        tmp_path,
        f"{STAMP_NS},a,3.1,1.1,{math.pi / 2},0,2,4,2,1,car,,,",
        f"{STAMP_NS + 10**8},b,3.1,1.1,{math.pi / 2},,,4,2,1,car,,,",
        f"{STAMP_NS + 10**8},b,1.1,1.1,{math.pi / 2},,,,,,,1.0,left,0.75",
        f"{STAMP_NS + 10**8},b,3.1,1.1,{math.pi / 2},,,,,,,1.0,stays,0.25",
        f"{STAMP_NS + 10**12},b,3.1,1.1,0,,,4,2,1,car,,,",
    )
    if suffix == ".parquet":
        polars.read_csv(path).write_parquet(path := path.with_suffix(suffix))
    forecasts, lines = write_outputs(bag, tmp_path / "mine.npz", **{**SHARP, "objects": str(path)})
    assert (forecasts.stamp_ns - STAMP_NS).tolist() == [0, 10**8]
    assert forecasts.available_ns.tolist() == forecasts.stamp_ns.tolist()
    ahead = box_cells((2.1, 4.1), (1.1, 5.1), CELL_M, SIZE)
    np.testing.assert_array_equal(occupied(forecasts, 1.0), ahead | wall(bag))
    moved, stayed = (box_cells((x, x + 2.0), (-0.9, 3.1), CELL_M, SIZE) for x in (0.1, 2.1))
    assert_allclose(forecasts.occupancy(1, 10), np.where(wall(bag), 1.0, 0.75 * moved + 0.25 * stayed), atol=0.003)
    assert any("rows with a stamp before or after the scans: 1 of them" in line for line in lines)


@pytest.mark.parametrize(
    ("header", "row", "says"),
    [
        ("stamp_ns,x\n", "5,1", "no y; the columns are stamp_ns, track"),
        ("stamp_ns,x,y,speed\n", "5,1,1,1", "unknown speed; the columns are"),
        ("stamp_ns,x,y\n", "5,1,wide", "conversion from `str` to `f64` failed"),
        ("stamp_ns,x,y\n", "5,1,", "1 rows without stamp_ns, x, y"),
        ("stamp_ns,x,y\n", "5,1,1", "no list of objects that can be used; rows with a stamp before or after"),
        ("stamp_ns,x,y,track,lead_s\n", f"{STAMP_NS},1,1,a,0.5", "has 0 rows with lead_s 0 or none: expected one"),
    ],
)
def test_a_table_with_a_fault_is_refused(tmp_path: Path, header: str, row: str, says: str) -> None:
    path = table(tmp_path, row, header=header)
    with pytest.raises(RecordingError, match=says):
        write_outputs(write_bag(tmp_path, ROS2), tmp_path / "mine.npz", objects=str(path))


def test_a_table_that_is_missing_or_binary_is_refused(tmp_path: Path) -> None:
    bag, binary = write_bag(tmp_path, ROS2), tmp_path / "a.parquet"
    binary.write_bytes(bytes(range(256)))
    for path in (binary, tmp_path / "none.csv"):
        with pytest.raises(RecordingError, match="cannot be read as a table of objects"):
            write_outputs(bag, tmp_path / "mine.npz", objects=str(path))


def test_the_conversions_of_the_page_give_rows_of_a_table(tmp_path: Path) -> None:
    page = Path("docs/recorded-bags.md").read_text()
    names: dict[str, Any] = {}
    exec(page.partition("```python")[2].partition("```")[0], names)
    (tmp_path / "tracks.txt").write_text("1,7,-1,-1,-1,-1,0.9,2.5,1.5,0\n3,7,-1,-1,-1,-1,0.9,3.5,1.5,0\n")
    second = list(names["mot_rows"](tmp_path / "tracks.txt", STAMP_NS, 10.0))[1]
    assert second == {"stamp_ns": STAMP_NS + 2 * 10**8, "track": 7, "x": 3.5, "y": 1.5}
    # a car 10 m ahead and 2 m to the right of the camera that looks the same way
    (tmp_path / "kitti.txt").write_text(f"0 4 Car 0 0 0 1 2 3 4 1.5 1.8 4.5 2 1 10 {-math.pi / 2}\n")
    (row,) = names["kitti_rows"](tmp_path / "kitti.txt", [STAMP_NS], [SE2(1.0, 0.0, math.pi / 2)])
    assert_allclose([row[name] for name in ("x", "y", "yaw", "length", "width")], [3, 10, math.pi / 2, 4.5, 1.8])
    box = {"translation": [1, 2, 0], "size": [1.8, 4.5, 1.5], "rotation": [math.sqrt(0.5), 0, 0, math.sqrt(0.5)]}
    box |= {"velocity": [0, 3], "tracking_id": "9", "tracking_name": "car", "tracking_score": 0.5}
    (row,) = names["nuscenes_rows"]({"t": [box]}, {"t": {"timestamp": STAMP_NS // 1000}})
    assert_allclose([row["yaw"], row["length"], row["vy"], row["existence"]], [math.pi / 2, 4.5, 3, 0.5])
    polars.DataFrame([row]).write_csv(tmp_path / "mine.csv")
    forecasts, _ = write_outputs(write_bag(tmp_path, ROS2), tmp_path / "mine.npz", objects=str(tmp_path / "mine.csv"))
    assert len(forecasts) == 1


# ---- drawing


def test_outlines_are_those_of_the_truth() -> None:
    """Against the rasteriser of the referee, at random poses, partly outside the window."""
    random, grid, window = np.random.default_rng(5), GridSpec(40, 0.25), SE2(1.0, -2.0)
    for _ in range(30):
        pose = random.uniform([-5.0, -8.0, -4.0], [7.0, 4.0, 4.0])
        outline = outline_of("car", *random.uniform(0.3, 6.0, 2))
        planes = np.zeros((1, *grid.shape), np.float32)
        draw_object(planes, RecordedObject("", pose, {}, outline), np.zeros(2), np.zeros(1), grid, window, 0.0)
        body = SceneObject(0, 0, SE2(*pose), outline.astype(np.float32))
        truth = truth_grid(Scene((), 255, (body,)), grid, window)
        assert ((planes[0] > 0.5) != (truth.cover == OUTLINE)).sum() <= 2, "float32 in the scene may move an edge"


def test_a_blurred_outline_is_the_mean_of_shifted_ones() -> None:
    grid, random = GridSpec(60, 0.2), np.random.default_rng(1)
    covariance = np.array([[0.16, 0.05], [0.05, 0.04]])
    one = RecordedObject("", np.array([0.33, -0.21, 0.4]), {}, outline_of("", 2.0, 1.0), 0.8, covariance)
    planes = np.zeros((1, *grid.shape), np.float32)
    draw_object(planes, one, np.zeros(2), np.zeros(1), grid, SE2(), 0.2)
    mean, sharp = np.zeros(grid.shape), np.zeros((1, *grid.shape), np.float32)
    for offset in random.multivariate_normal([0.0, 0.0], covariance, 4000):
        sharp[:] = 0.0
        shifted = RecordedObject("", one.pose + np.array([*offset, 0.0]), {}, one.outline)
        draw_object(sharp, shifted, np.zeros(2), np.zeros(1), grid, SE2(), 0.0)
        mean += sharp[0] / 4000
    assert_allclose(planes[0], 0.8 * mean, atol=0.08)
    assert abs(planes[0].sum() / (0.8 * mean.sum()) - 1.0) < 0.05


def test_a_position_that_may_be_anywhere_is_not_drawn() -> None:
    assert blur(np.eye(2) * 101.0**2, 100) is None
    assert_allclose(blur(np.zeros((2, 2)), 100), [[0, 0, 0], [0, 1, 0], [0, 0, 0]], atol=1e-6)


def test_a_path_goes_on_after_its_end_and_turns_the_short_way() -> None:
    path = PredictedPath(1.0, np.array([0.0, 1.0]), np.array([[0.0, 0.0, 3.0], [1.0, 2.0, -3.0]]))
    expected = [[0.0, 0.0, 3.0], [0.5, 1.0, math.pi], [2.0, 4.0, -3.0 + 2 * math.pi]]
    assert_allclose(poses_at(path, np.array([0.0, 0.5, 2.0])), expected)


def test_the_static_map_keeps_what_was_mostly_occupied_while_the_window_scrolls() -> None:
    grid = GridSpec(20, 0.5)
    static, shape = StaticMap(grid), grid.shape
    frame = next(iter(open_stream("data/leg_tracker/leg_tracker.mcap", grid=grid)))

    def seen(occupied_cells: list[tuple[int, int]], window: SE2) -> None:
        occupied_now = np.zeros(shape, np.bool_)
        occupied_now[tuple(np.transpose(occupied_cells))] = True
        fields = {"visible": np.ones(shape, np.bool_), "occupied": occupied_now, "world_T_grid": window}
        static.add(
            type(frame)(
                frame.stamp_ns, **fields, origins=frame.origins, points=frame.points, point_origin=frame.point_origin
            )
        )

    seen([(5, 5), (8, 8)], SE2())
    seen([(5, 5), (9, 9)], SE2())
    seen([(5, 3)], SE2(1.0, 0.0))  # two columns to the right
    found = static.probability
    assert found[5, 3] == 1.0
    assert found.sum() == 1.0, "cells that were occupied in half of the frames or less are not static"
