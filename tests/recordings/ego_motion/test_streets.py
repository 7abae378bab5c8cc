"""Along a street only the car in front seems to tell how far one has driven: it is not believed, and that is told."""

from __future__ import annotations

import math
from dataclasses import replace

from gridtrack.common.geometry import SE2
from gridtrack.common.scan import Scan
from gridtrack.common.scene import Outline
from gridtrack.recordings.ego_motion import MatchedTrajectory, MatchingSettings, matched_trajectory

from scenes.drives import BARE_STREET, CAR, STREET, away, car_in_front, drive, straight

SCANS = 90


def along(street: tuple[Outline, ...], *, odometry_noise: float = 0.0) -> list[Scan]:
    return drive(street, away, SCANS, crowd=car_in_front, body=CAR, odometry_noise=odometry_noise)


def alone(scans: list[Scan]) -> MatchedTrajectory:
    """From the scans, without recorded poses."""
    return matched_trajectory([replace(scan, world_T_sensor=SE2()) for scan in scans], "kiss-icp", MatchingSettings())


def last_error_m(scans: list[Scan], found: MatchedTrajectory) -> float:
    true, last = scans[-1].reference_T_sensor or SE2(), found.matched[-1]
    return math.hypot(last.x - true.x, last.y - true.y)


def test_a_car_in_front_does_not_drag_the_pose_when_nothing_else_tells_the_motion_along_a_street() -> None:
    scans = along(STREET)
    found = alone(scans)
    driven = away((SCANS - 1) * 0.1).x
    assert driven > 30.0
    assert last_error_m(scans, found) < 0.1 * driven
    assert [quality.outcome for quality in found.qualities[:20]] == ["start", *["matched"] * 19]
    assert found.qualities[-1].outcome == "partial"  # the pillars are behind


def test_where_only_a_car_in_front_seems_to_tell_the_motion_it_is_told_that_nothing_constrains_it() -> None:
    found = alone(along(BARE_STREET))
    assert sum(quality.fell_back for quality in found.qualities) > 0.95 * (SCANS - 1)
    assert "s, use the motion before instead of the match or a part of it" in found.describe("kiss-icp")


def test_along_a_street_with_a_car_in_front_the_pose_is_that_of_odometry() -> None:
    scans = along(BARE_STREET, odometry_noise=0.02)
    found = matched_trajectory(scans, "refined", MatchingSettings())
    assert {quality.outcome for quality in found.qualities[1:]} == {"partial"}
    drifted = scans[-1].world_T_sensor.x - (scans[-1].reference_T_sensor or SE2()).x
    assert last_error_m(scans, found) < abs(drifted) + 0.1


def test_a_queue_of_cars_beside_the_sensor_drags_the_pose_and_that_it_may_is_told() -> None:
    """Scans cannot tell a queue that sets off from a robot that slows down, where the houses are bare."""

    def queue(time_s: float) -> list[tuple[float, float]]:
        return [(away(max(time_s - 3.0, 0.0)).x + 6.0 * k, 3.5) for k in range(-4, 4)]

    scans = drive(BARE_STREET, straight, SCANS, crowd=queue, body=CAR)
    found = alone(scans)
    assert sum(found.by_objects) > 0.5 * SCANS
    assert "have a direction that only surfaces of less than 6 m constrain" in found.describe("kiss-icp")
    assert "only surfaces" not in found.describe("refined")
    assert last_error_m(scans, found) > 5.0
