"""Parts of the matching: normals of walls, deskewed returns, moving returns, and drift from odometry."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from gridtrack.common.geometry import SE2
from gridtrack.common.scan import Scan
from gridtrack.recordings.ego_motion.matching import DriftFromOdometry
from gridtrack.recordings.ego_motion.returns import (
    EarlierScans,
    PlaneArray,
    ScanReturns,
    deskewed,
    returns_at,
    returns_of,
    surfaces,
    wall_normals,
)


def test_the_normal_of_a_wall_is_across_it() -> None:
    along = np.linspace(-2.0, 2.0, 80)
    direction, noise = math.radians(25.0), np.random.default_rng(0).normal(0.0, 0.01, 80)
    wall = SE2(3.0, 0.0, direction).apply(np.stack([along, noise], axis=1))
    normals, on_wall = wall_normals(wall)
    across = np.abs(normals @ [-math.sin(direction), math.cos(direction)])
    assert on_wall.all()
    assert np.median(across) > 0.99


def test_most_scattered_points_have_no_normal() -> None:
    cloud = np.random.default_rng(0).uniform(-0.3, 0.3, (60, 2))
    assert np.mean(wall_normals(cloud)[1]) < 0.3
    assert not wall_normals(cloud[:2])[1].any()


def test_deskewed_points_are_in_the_sensor_frame_at_the_stamp() -> None:
    motion = SE2(0.1, 0.02, 0.05)
    here = np.random.default_rng(0).uniform(-5.0, 5.0, (50, 2))
    share = np.linspace(0.0, 1.0, 50)
    on_the_way = [SE2(s * motion.x, s * motion.y, s * motion.theta) for s in share.tolist()]
    seen = np.concatenate([pose.inverse().apply(here[[i]]) for i, pose in enumerate(on_the_way)])
    np.testing.assert_allclose(deskewed(seen, share, motion), here, atol=1e-12)


def test_invalid_and_far_ranges_are_no_returns() -> None:
    ranges = np.array([0.0, np.nan, np.inf, -np.inf, 0.05, 3.0, 25.0, 4.0], np.float32)
    returns = returns_of(Scan(0, ranges, 0.0, 0.1, 0.1, 50.0), SE2(), 0.0)
    np.testing.assert_allclose(np.hypot(*returns.points.T), [3.0, 4.0], rtol=1e-6)


def scan(ranges: float, beams: int = 9) -> Scan:
    return Scan(0, np.full(beams, ranges, np.float32), -0.4, 0.1, 0.1, 10.0)


def now(points: PlaneArray, stamp_ns: int) -> tuple[Scan, ScanReturns]:
    """A scan without free space, and returns (N, 2) in it."""
    blind = replace(scan(math.nan), stamp_ns=stamp_ns)
    return blind, returns_at(points)


def test_a_return_in_the_free_space_of_an_earlier_scan_moves() -> None:
    earlier = EarlierScans()
    earlier.add(scan(5.0), returns_of(scan(5.0), SE2(), 0.0).points, SE2())
    points = np.array([[2.0, 0.0], [4.9, 0.0], [5.5, 0.0], [-2.0, 0.0]])
    assert earlier.moving(*now(points, 800_000_000), SE2()).tolist() == [True, False, False, False]
    assert not earlier.moving(*now(points, 100_000_000), SE2()).any()  # the earlier scan is too young
    assert not earlier.moving(*now(points, 800_000_000), SE2(0.0, 20.0, 0.0)).any()


def test_a_beam_without_return_is_free_and_an_invalid_one_unknown() -> None:
    for ranges, moves in ((math.inf, True), (math.nan, False)):
        earlier = EarlierScans()
        earlier.add(scan(ranges), np.zeros((0, 2)), SE2())
        assert earlier.moving(*now(np.array([[2.0, 0.0]]), 800_000_000), SE2()).tolist() == [moves]


def test_a_scan_without_beams_finds_no_motion() -> None:
    silent = replace(scan(math.nan), ranges=np.empty(0, np.float32))
    earlier = EarlierScans()
    earlier.add(silent, np.zeros((0, 2)), SE2())
    assert not earlier.moving(*now(np.array([[2.0, 0.0]]), 800_000_000), SE2()).any()
    earlier.add(scan(5.0), np.zeros((0, 2)), SE2())
    assert earlier.moving(replace(silent, stamp_ns=800_000_000), returns_at(np.zeros((0, 2))), SE2()).size == 0


def test_a_cluster_that_left_its_place_moves() -> None:
    """A car 4 m ahead drives away at 2 m/s: it hid the place where it is now."""
    earlier = EarlierScans()
    earlier.add(scan(4.0), returns_of(scan(4.0), SE2(), 0.0).points, SE2())
    later = replace(scan(4.8), stamp_ns=400_000_000)
    points = np.concatenate([returns_of(later, SE2(), 0.0).points, [[-3.0, 0.0]]])
    returns = returns_at(points)
    assert earlier.moving(later, returns, SE2()).tolist() == [True] * 9 + [False]


def test_a_return_represents_the_surface_around_it_and_near_ones_are_one_cluster() -> None:
    points = np.array([[2.0, 0.0], [2.0, 0.1], [2.0, 0.3], [2.0, 5.0]])
    length, cluster, extent = surfaces(points)
    np.testing.assert_allclose(length, [0.2, 0.15, 0.25, 0.3])
    assert cluster.tolist() == [0, 0, 0, 1]
    np.testing.assert_allclose(extent, [0.3, 0.3, 0.3, 0.0])


@pytest.mark.parametrize(
    ("differences_m", "first", "end"),
    [
        pytest.param([0.0] * 10 + [0.04] * 15 + [0.0] * 15, 15, 35, id="in one direction"),
        pytest.param([0.02, -0.02] * 10 + [0.5] + [-0.02, 0.02] * 10, None, None, id="one slip and noise"),
        pytest.param([0.2] * 3, None, None, id="too few scans"),
    ],
)
def test_differences_in_one_direction_are_a_drift_from_odometry(differences_m, first, end) -> None:
    """Ten matches a second that differ from odometry along x; the drift ends a second after the differences."""
    drift, predicted = DriftFromOdometry(), SE2(3.0, 4.0, 0.5)
    found = [
        drift.grows(k * 100_000_000, predicted, SE2(3.0 + off_m, 4.0, 0.5), 0.006)
        for k, off_m in enumerate(differences_m)
    ]
    assert not any(found[:first])
    if first is not None:
        assert all(found[first + 5 : end - 10])
        assert not any(found[end:])
