"""Lasers on a road user: their returns lie on the true scene in every frame and at every speed."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from gridtrack.common.errors import GridtrackError
from gridtrack.common.geometry import SE2, same_pose
from gridtrack.common.grid import GridSpec, window_about
from gridtrack.common.scan import Scan
from gridtrack.recordings import open_recording
from gridtrack.recordings.truth import OUTLINE, truth_grid
from gridtrack.simulation.laser import Laser
from gridtrack.simulation.motion import WheelOdometry
from gridtrack.simulation.tracks import Carrier, Tracks
from gridtrack.simulation.tracks_file import METADATA_KEY, read_tracks, write_recording
from gridtrack.simulation.traffic import check_traffic
from tests.simulation.conftest import CLASSES, tracks_of

pytestmark = pytest.mark.usefixtures("own_cache")
NORTH_WALL = ((-50.0, 6.0), (50.0, 6.0), (50.0, 7.0), (-50.0, 7.0))
EAST_WALL = ((30.0, -50.0), (31.0, -50.0), (31.0, 5.0), (30.0, 5.0))
LASER = Laser(angle_min=-np.pi, angle_increment=np.radians(1.0), beams=360)
SPEED_M_S = 14.0


def drive(odometry: WheelOdometry | None = None, frames: int = 24, **lasers: Laser) -> Tracks:
    """A car (track 7) that drives east at 14 m/s and then turns left, and a pedestrian (track 3) standing at (0, 3)."""
    time_s = np.arange(frames) / 8.0
    heading = np.clip(time_s - 2.0, 0.0, None) * 1.2
    step = (
        SPEED_M_S / 8.0 * np.column_stack([np.cos(heading), np.sin(heading)]) * np.minimum(1.0, 3.0 - time_s)[:, None]
    )
    car = np.column_stack([np.array([-20.0, 0.0]) + np.cumsum(step, axis=0), heading])
    users = (3, 0, np.tile([0.0, 3.0, 0.5], (frames, 1)), (0.3, 0.5)), (7, 2, car, (4.5, 1.82))
    about = {"static": (NORTH_WALL, EAST_WALL), "carrier": Carrier(track=7, odometry=odometry)}
    return tracks_of(*users, lasers=lasers or {"scan": LASER}, **about)


def returns(scan: Scan, world_T_sensor: SE2) -> np.ndarray:
    """The ends of the beams with a return, world frame."""
    seen = np.isfinite(scan.ranges)
    angles = (scan.angle_min + scan.angle_increment * np.arange(scan.ranges.size))[seen]
    return world_T_sensor.apply(scan.ranges[seen, None] * np.column_stack([np.cos(angles), np.sin(angles)]))


def off_the_scene(points: np.ndarray) -> np.ndarray:
    """The distance of points to the walls and the pedestrian, metres."""
    outlines = [np.array(NORTH_WALL), np.array(EAST_WALL)]
    distance = [abs(np.hypot(points[:, 0], points[:, 1] - 3.0) - 0.2)]
    for outline in outlines:
        for p, q in zip(outline, np.roll(outline, -1, axis=0), strict=True):
            share = np.clip((points - p) @ (q - p) / ((q - p) @ (q - p)), 0.0, 1.0)
            distance.append(np.linalg.norm(points - p - share[:, None] * (q - p), axis=1))
    return np.min(distance, axis=0)


def test_walls_stay_in_place_while_the_laser_drives_and_turns() -> None:
    tracks = drive()
    scans = list(tracks.scans())
    assert len(scans) == 24
    poses = [scan.world_T_sensor for scan in scans]
    assert max(np.diff([pose.x for pose in poses])) == pytest.approx(SPEED_M_S / 8.0, abs=0.011)
    assert poses[-1].theta > 1.0
    points = np.concatenate([returns(scan, scan.world_T_sensor) for scan in scans])
    assert len(points) > 3000
    assert np.percentile(off_the_scene(points), 99.9) < 0.2
    assert off_the_scene(points).mean() < 0.04
    assert all(scan.reference_T_sensor is None for scan in scans)


def test_the_carrier_is_neither_in_the_scans_nor_in_the_true_scene() -> None:
    scans = list(drive().scans())
    assert min(scan.ranges.min() for scan in scans) > 2.0
    assert {track.track for scan in scans for track in scan.scene.objects} == {3}
    assert not any((scan.labels == CLASSES.index("car")).any() for scan in scans)
    assert any((scan.labels == CLASSES.index("pedestrian")).any() for scan in scans)


def test_returns_are_on_true_cells_in_the_window_of_every_frame() -> None:
    grid = GridSpec()
    for scan in drive().scans():
        window = window_about(scan.world_T_sensor, grid.cell_m)
        truth = truth_grid(scan.scene, grid, window)
        cells, inside = grid.cells_of(window.inverse().apply(returns(scan, scan.world_T_sensor)))
        near = np.pad(truth.cover == OUTLINE, 1)
        near = np.any([near[1 + r : 101 + r, 1 + c : 101 + c] for r in (-1, 0, 1) for c in (-1, 0, 1)], axis=0)
        assert near[tuple(cells[inside].T)].mean() > 0.97


def test_a_laser_has_the_pose_of_its_mount() -> None:
    mounted = Laser(x=1.5, y=-0.5, theta=np.pi / 2, angle_min=0.0, beams=1)
    first = next(drive(ahead=mounted).scans())
    body = drive().pose[1]
    assert same_pose(first.world_T_sensor, SE2(body[0] + 1.5, body[1] - 0.5, np.pi / 2))
    assert first.ranges[0] == pytest.approx(6.5, abs=0.15)
    assert first.sensor == "ahead"


def test_recorded_poses_drift_and_the_reference_stays_true() -> None:
    exact, noisy = list(drive().scans()), list(drive(WheelOdometry(seed=5).scaled(5.0)).scans())
    for true, drifting in zip(exact, noisy, strict=True):
        assert drifting.reference_T_sensor == true.world_T_sensor
        assert (drifting.ranges == true.ranges).all()
    assert noisy[0].world_T_sensor == exact[0].world_T_sensor
    last = noisy[-1]
    error = last.reference_T_sensor.inverse() @ last.world_T_sensor
    assert np.hypot(error.x, error.y) > 0.3
    assert off_the_scene(returns(last, last.reference_T_sensor)).max() < 0.3
    assert np.percentile(off_the_scene(returns(last, last.world_T_sensor)), 90) > 0.3


def test_drives_round_trip_with_their_reference_poses(tmp_path: Path) -> None:
    tracks = drive(WheelOdometry(seed=5), front=LASER, rear=Laser(x=-2.0, theta=np.pi))
    write_recording(tmp_path / "drive.tracks", tracks)
    assert read_tracks(tmp_path / "drive.tracks").info == tracks.info
    recording = open_recording(tmp_path / "drive.tracks")
    assert recording.survey.moves
    assert list(recording.survey.sensors) == ["front", "rear"]
    for found, expected in zip(recording.scans(), tracks.scans(), strict=True):
        assert (found.sensor, found.stamp_ns) == (expected.sensor, expected.stamp_ns)
        assert same_pose(found.world_T_sensor, expected.world_T_sensor)
        assert same_pose(found.reference_T_sensor, expected.reference_T_sensor)
        np.testing.assert_array_equal(found.ranges, expected.ranges)
        assert len(found.scene.objects) == 1


def test_the_scans_of_a_laser_do_not_depend_on_the_lasers_after_it(tmp_path: Path) -> None:
    write_recording(tmp_path / "two.tracks", drive(front=LASER, rear=Laser(x=-2.0, theta=np.pi)))
    alone = list(drive(front=LASER).scans())
    found = list(open_recording(tmp_path / "two.tracks", topic="/scan/front").scans())
    for one, other in zip(found, alone, strict=True):
        np.testing.assert_array_equal(one.ranges, other.ranges)


def test_a_file_with_one_standing_laser_has_schema_1(tmp_path: Path) -> None:
    def metadata(tracks: Tracks) -> dict[str, object]:
        write_recording(tmp_path / "a.tracks", tracks)
        found: dict[str, object] = json.loads(pq.read_schema(tmp_path / "a.tracks").metadata[METADATA_KEY])
        return found

    tracks = drive()
    assert metadata(tracks)["schema"] == 2
    standing = dataclasses.replace(tracks, info=tracks.info.model_copy(update={"carrier": None}))
    found = metadata(standing)
    assert list(found)[:3] == ["schema", "recording", "laser"]
    assert not {"lasers", "carrier"} & set(found)
    assert read_tracks(tmp_path / "a.tracks").info == standing.info


@pytest.mark.parametrize(
    ("about", "message"),
    [
        ({"carrier": {"track": 9}}, "the carrier of the lasers is not in every frame"),
        ({"carrier": {"track": -1}}, "greater than or equal to 0"),
        ({"carrier": {"track": 7, "odometry": {"wheel_std": 1e300}}}, "less than or equal to 1"),
        ({"carrier": {"track": 7, "odometry": {"track_width_m": 0.0}}}, "greater than 0"),
        ({"frames": 30}, "the carrier of the lasers is not in every frame"),
        ({"lasers": {}}, "at least 1"),
        ({"lasers": {f"l{i}": {} for i in range(9)}}, "at most 8"),
        ({"lasers": {"../a": {}}}, "the name of a laser: expected"),
        ({"lasers": {"a": {"beams": 10**9}}}, "less than or equal to 100000"),
        (
            {"lasers": {n: {"beams": 100_000, "angle_increment": 1e-5} for n in "ab"}, "frames": 5001},
            "1000200000 beams",
        ),
    ],
)
def test_a_file_without_a_valid_carrier_or_lasers_is_one_line_of_error(altered, about, message: str) -> None:
    with pytest.raises(GridtrackError, match=message):
        list(open_recording(altered(drive(), lambda values: values | about)).scans())


def test_the_check_follows_the_laser_and_excludes_its_carrier() -> None:
    traffic = check_traffic(drive())
    near = np.abs(drive().sensor_poses("scan")[:, 0]) < 10.0
    pedestrian, _, car, _ = traffic.classes
    assert traffic.faults == ()
    assert car.present == 0.0
    assert pedestrian.present == pytest.approx(near.mean(), abs=0.05)


def test_the_check_finds_somebody_on_the_laser_of_a_moving_carrier() -> None:
    tracks = drive()
    pose = tracks.pose.copy()
    pose[20] = pose[21]
    faults = check_traffic(dataclasses.replace(tracks, pose=pose)).faults
    assert faults == ("pedestrian on the laser in 1 positions, the first of track 3 in frame 10",)
