"""Drives through the junction: the choice of the carrier, its laser, and a laser standing beside its path."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from gridtrack.common.geometry import same_pose
from gridtrack.recordings import RecordingInfo, open_recording, packaged_recording
from gridtrack.simulation import junction
from gridtrack.simulation import traffic as checks
from gridtrack.simulation.junction import TWO_CORNERS, drives, layout, seen, simulate_junction
from gridtrack.simulation.junction.drives import (
    CARRIERS,
    ROAD_USER_CLEARANCE_M,
    Drive,
    furthest,
    simulate_drive,
    standing_beside,
)
from gridtrack.simulation.sumo import SimulationError
from gridtrack.simulation.tracks import Tracks, TracksInfo
from gridtrack.simulation.tracks_file import read_tracks, write_recording
from gridtrack.simulation.traffic import check_traffic, inside

pytestmark = pytest.mark.usefixtures("own_cache")
CAR = layout.JUNCTION_CLASSES.index("car")
FRAMES = 160
LASER_ANGLES = layout.LASER.angle_min + layout.LASER.angle_increment * np.arange(layout.LASER.beams)


def straight(track: int, first: int, metres: float, x: float, speed: float, y: float = -2.1) -> np.ndarray:
    """Rows frame, track, x, y, heading of a road user that drives `metres` to the east from `x`."""
    steps = np.arange(round(metres / speed * layout.RATE_HZ) + 1)
    columns = [first + steps, np.full(len(steps), track), x + steps * speed / layout.RATE_HZ]
    return np.column_stack([*columns, np.full(len(steps), y), np.zeros(len(steps))])


def traffic(*rows: np.ndarray, label: int = CAR, size: tuple[float, float] = (4.5, 1.82)) -> Tracks:
    """Road users of one class in the junction, without a simulator."""
    table = np.concatenate(rows)
    table = table[np.lexsort((table[:, 1], table[:, 0]))]
    info = TracksInfo(
        recording=RecordingInfo(site="junction", classes=layout.JUNCTION_CLASSES, rate_hz=layout.RATE_HZ),
        lasers={"scan": layout.LASER},
        frames=FRAMES,
        rate_hz=layout.RATE_HZ,
        noise_seed=11,
        static_class="static",
    )
    frame, track = table[:, :2].astype(np.int64).T
    n = len(table)
    return Tracks(info, frame, track, np.full(n, label), table[:, 2:], np.tile(size, (n, 1))).rounded()


def test_the_carrier_moves_furthest_among_all_that_pass_the_middle() -> None:
    through, faster = straight(0, 0, 90.0, -50.0, 6.0), straight(1, 0, 95.0, -50.0, 8.0)
    turned_back, beyond = straight(2, 0, 120.0, -130.0, 9.0), straight(3, 0, 120.0, 20.0, 9.0)
    assert furthest(traffic(through, faster, turned_back, beyond), CAR, 80, 8.0) == (1, 0)
    # 0.75 m per frame: from -44 m, the 80th frame is the first one more than 15 m behind the middle
    assert furthest(traffic(through), CAR, 80, 8.0) == (0, 8)
    assert furthest(traffic(turned_back, beyond), CAR, 80, 8.0) is None
    assert furthest(traffic(through), CAR, 140, 8.0) is None
    assert furthest(traffic(through), CAR - 1, 80, 8.0) is None


def drive(carrier: str = "car") -> Drive:
    """A car at 6 m/s with another one 12 m behind it, and a waiting car in another street."""
    waiting = np.column_stack([np.arange(FRAMES), np.full(FRAMES, 9), *np.tile([2.1, -14.0, np.pi / 2], (FRAMES, 1)).T])
    cars = traffic(straight(0, 0, 119.3, -50.0, 6.0), straight(1, 0, 119.3, -62.0, 6.0), waiting)
    return Drive(cars, 0, carrier, "gridtrack simulate junction --minutes 1")


def test_a_carried_laser_is_in_the_middle_of_its_road_user(tmp_path: Path) -> None:
    write_recording(tmp_path / "drive.tracks", drive().carried())
    recording = open_recording(tmp_path / "drive.tracks")
    assert recording.info.command == "gridtrack simulate junction --minutes 1 --carrier car --sensor drive"
    assert recording.info.grid == "100x0.2@-10,-10"
    scans = list(recording.scans())
    assert [scan.world_T_sensor.x for scan in scans[::40]] == pytest.approx([-50.0, -20.0, 10.0, 40.0])
    assert all({body.track for body in scan.scene.objects} <= {1, 9} for scan in scans)
    assert {9} < {body.track for scan in scans for body in scan.scene.objects}
    assert check_traffic(drive().carried()).faults == ()


def test_odometry_noise_moves_the_recorded_poses_and_nothing_else() -> None:
    exact, noisy, twice = drive().carried(), drive().carried(1.0), drive().carried(2.0)
    assert noisy.info.recording.command.endswith("--sensor drive --odometry-noise 1")
    for true, once, more in zip(exact.scans(), noisy.scans(), twice.scans(), strict=True):
        assert (true.ranges == once.ranges).all()
        assert true.reference_T_sensor is None
        assert once.reference_T_sensor == more.reference_T_sensor == true.world_T_sensor
    errors = [scan.world_T_sensor.theta - scan.reference_T_sensor.theta for scan in (once, more)]
    assert errors[1] == pytest.approx(2.0 * errors[0], rel=1e-6)
    assert abs(errors[0]) > 1e-3


def test_a_car_has_a_wider_track_than_a_robot() -> None:
    widths = [drive(carrier).carried(1.0).info.carrier.odometry.track_width_m for carrier in CARRIERS]
    assert widths == [1.5, 0.4]


def test_a_standing_laser_is_beside_the_position_at_half_time_and_faces_it() -> None:
    beside = drive().beside()
    laser = beside.info.lasers["scan"]
    half = drive().traffic.pose[drive().traffic.track == 0][80]
    assert np.hypot(laser.x - half[0], laser.y - half[1]) < 8.0
    assert abs(laser.y) > layout.LANE_EDGE_M
    ahead = laser.pose.inverse().apply(half[None, :2])[0]
    assert np.arctan2(ahead[1], ahead[0]) == pytest.approx(0.0, abs=0.01)
    assert beside.info.carrier is None
    assert {0, 1, 9} == set(beside.track.tolist())
    assert check_traffic(beside).faults == ()


def test_a_standing_laser_is_clear_of_walls_and_road_users() -> None:
    lane = straight(0, 0, 119.3, -50.0, 6.0)
    alone = standing_beside(traffic(lane), 0.0, -5.5)
    walkers = np.column_stack([np.arange(FRAMES), np.full(FRAMES, 5), *np.tile([0.3, -5.2, 0.0], (FRAMES, 1)).T])
    crowded = standing_beside(traffic(lane, walkers, size=(1.0, 1.0)), 0.0, -5.5)
    assert abs(alone.y + 5.5) < 0.2
    assert max(abs(crowded.x - 0.3), abs(crowded.y + 5.2)) > 0.5 + ROAD_USER_CLEARANCE_M / 2.0
    for laser in (alone, crowded, standing_beside(traffic(lane), 30.0, -8.5)):
        place = np.array([[laser.x, laser.y]])
        assert not any(inside(place, np.array(outline))[0] for outline in layout.street_outlines())
    with pytest.raises(SimulationError, match="no place within 15 m"):
        standing_beside(traffic(lane), 26.0, 26.0)


def test_the_further_houses_are_beside_the_streets_and_do_not_overlap() -> None:
    outlines = [np.array(outline) for outline in layout.street_outlines()]
    assert len(outlines) == len(layout.static_outlines()) + 40
    for outline in outlines:
        x, y = outline.T
        assert (x * np.roll(y, -1) - np.roll(x, -1) * y).sum() > 0.0
        assert np.abs(outline).min(axis=1).max() >= 7.0
    far = outlines[-40:]
    for house in far:
        assert (np.abs(house).min(axis=1) >= layout.FACADE_M).all()
        assert not any(inside(house.mean(axis=0)[None], other)[0] for other in outlines if other is not house)


def test_two_lasers_are_on_opposite_corners_beside_the_streets() -> None:
    cars = drive().traffic
    both = seen(cars, TWO_CORNERS, "")
    assert both.info.recording.grid == layout.JUNCTION_GRID
    one, other = layout.CORNER_LASERS.values()
    assert same_pose(one.pose, layout.LASER.pose)
    assert (one.x < 0 < one.y, other.y < 0 < other.x) == (True, True)
    assert not any(inside(np.array([[other.x, other.y]]), np.array(house))[0] for house in layout.static_outlines())
    blind = np.arctan2(other.y, other.x)
    assert not other.angle_min <= blind % (2 * np.pi) <= other.angle_min + other.beams * other.angle_increment
    scans = list(both.scans())
    assert [scan.sensor for scan in scans[:2]] == list(layout.CORNER_LASERS)
    assert len(scans) == 2 * FRAMES
    seen_by_both = [{int(label) for label in scan.labels} for scan in scans[140:142]]
    assert all(CAR in labels for labels in seen_by_both)
    alone = list(seen(cars, dataclasses.replace(TWO_CORNERS, lasers={"scan": layout.LASER}), "").scans())
    assert all((a.ranges == b.ranges).all() for a, b in zip(alone, scans[::2], strict=True))


def test_no_drive_of_the_duration_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drives, "simulate_traffic", lambda frames, seed, start_s: drive().traffic)
    assert simulate_drive(0.15, 3, 60.0, "car").track == 0
    with pytest.raises(SimulationError, match=r"no car drives through .* for 0\.4 minutes with seed 3"):
        simulate_drive(0.4, 3, 60.0, "car")


def test_nobody_walks_through_the_lasers_on_two_corners(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checks, "STRIDE", 240)  # moving cells are not checked here
    for name in ("test-102", "test-111", "test-120"):
        recorded = read_tracks(packaged_recording(f"junction/{name}"))
        assert checks.check_traffic(seen(recorded, TWO_CORNERS, "")).faults == ()


# ---- with SUMO


@pytest.fixture(scope="module")
def simulated() -> Tracks:
    """The traffic of a robot's drive."""
    pytest.importorskip("sumo", reason="SUMO is not installed")
    return junction.simulate_traffic(round(60.0 * layout.RATE_HZ), 3, 20.0)


def test_a_robot_drives_in_the_traffic_of_sumo(simulated: Tracks, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drives, "simulate_traffic", lambda frames, seed, start_s: simulated)
    found = simulate_drive(0.4, 3, 20.0, "robot").carried(1.0)
    assert found.info.recording.command == (
        "gridtrack simulate junction --minutes 0.4 --seed 3 --start 20s --carrier robot --sensor drive"
        " --odometry-noise 1"
    )
    poses = found.sensor_poses("scan")
    assert len(poses) == 192
    assert np.hypot(*np.diff(poses[:, :2], axis=0).T).max() * layout.RATE_HZ < 2.5
    assert check_traffic(found).faults == ()


def test_two_corners_have_the_traffic_of_one(simulated: Tracks, monkeypatch: pytest.MonkeyPatch) -> None:
    first = simulated.where(simulated.frame < 48)
    part = dataclasses.replace(first, info=first.info.model_copy(update={"frames": 48}))
    monkeypatch.setattr(junction, "simulate_traffic", lambda frames, seed, start_s: part)
    one, two = simulate_junction(0.1, 1, 60.0), simulate_junction(0.1, 1, 60.0, TWO_CORNERS)
    assert two.info.recording.command.endswith("--seed 1 --start 60s --sensor corners")
    north_west = [scan for scan in two.scans() if scan.sensor == "north-west"]
    post = abs(LASER_ANGLES - np.arctan2(-15.87, 15.87)) < 0.01
    for alone, beside in zip(one.scans(), north_west, strict=True):
        near = (alone.ranges < 29.0) & ~post
        assert (alone.ranges[near] == beside.ranges[near]).all()
