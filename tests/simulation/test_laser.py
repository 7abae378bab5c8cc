"""The simulated laser measures the nearest side of any outline, and has each kind of error as stated."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gridtrack.common.geometry import SE2
from gridtrack.common.scan import Scan
from gridtrack.common.scene import UNLABELLED, Scene, SceneObject
from gridtrack.simulation.bodies import body_outline
from gridtrack.simulation.laser import MATT, TICK_M, Laser, LaserErrors, SceneSurfaces, sweep, with_noise

SQUARE = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], np.float32)
EXACT = {"std_m": 0.0, "glass_seen": 1.0, "dark_reach": 1.0}
PANE = ((2.0, -3.0), (2.02, -3.0), (2.02, 3.0), (2.0, 3.0))
NEAR_WALL = ((4.0, -9.0), (4.2, -9.0), (4.2, 0.0), (4.0, 0.0))
FAR_WALL = ((5.0, 0.0), (5.2, 0.0), (5.2, 9.0), (5.0, 9.0))


def every_side(scene: Scene, pose: SE2, angle_min: float, increment: float, beams: int, range_max: float):
    """Each beam as a complex direction against each side, in the world frame: slow and simple."""
    sides = [(outline.astype(np.float64), scene.static_label) for outline in scene.static]
    sides += [(thing.world_T_object.apply(thing.outline), thing.label) for thing in scene.objects]
    ranges, labels = np.full(beams, np.inf), np.full(beams, 255)
    for i in range(beams):
        angle = pose.theta + angle_min + i * increment
        for corners, label in sides:
            for p, q in zip(corners, np.roll(corners, -1, axis=0), strict=True):
                matrix = np.array([[math.cos(angle), p[0] - q[0]], [math.sin(angle), p[1] - q[1]]])
                if abs(np.linalg.det(matrix)) < 1e-12:
                    continue
                distance, share = np.linalg.solve(matrix, p - [pose.x, pose.y])
                if 0 <= share <= 1 and 0 <= distance <= range_max and distance < ranges[i]:
                    ranges[i], labels[i] = distance, label
    return ranges, labels


def test_a_hand_drawn_scene():
    """A car 5 m ahead in front of a wall at 10 m, a pedestrian to the left, nothing to the right."""
    wall = np.array([[10, -20], [11, -20], [11, 20], [10, 20]], np.float32)
    car = SceneObject(7, 2, SE2(6.0, 0.0, math.pi / 2), SQUARE)
    pedestrian = SceneObject(8, 0, SE2(0.0, 3.0, 0.0), SQUARE)
    ranges, labels = sweep(Scene((wall,), 4, (car, pedestrian)), SE2(), -math.pi / 2, math.pi / 4, 5, 30.0)
    assert ranges == pytest.approx([math.inf, 10 * math.sqrt(2), 5.0, 10 * math.sqrt(2), 2.0])
    assert labels.tolist() == [255, 4, 2, 4, 0]
    assert (ranges.dtype, labels.dtype) == (np.float32, np.uint8)


def test_an_empty_scene_returns_nothing():
    ranges, labels = sweep(Scene((), 4, ()), SE2(), 0.0, 0.1, 3, 7.9)
    assert (ranges.tolist(), labels.tolist()) == ([math.inf] * 3, [255] * 3)


def test_no_beam_passes_through_a_corner():
    ranges, _ = sweep(Scene((SQUARE * 5,), 4, ()), SE2(), -math.pi, math.pi / 720, 1440, 30.0)
    assert np.isfinite(ranges).all()
    assert ranges.min() == pytest.approx(5.0)
    assert ranges.max() == pytest.approx(5.0 * math.sqrt(2))


def invented(random: np.random.Generator) -> tuple[Scene, SE2]:
    """Three to six irregular outlines, which may cross each other, and a sensor that may be inside one."""

    def outline() -> np.ndarray:
        return random.uniform(-4, 4, (random.integers(3, 7), 2)).astype(np.float32)

    def pose() -> SE2:
        return SE2(*random.uniform(-7, 7, 3))

    things = tuple(SceneObject(i, i, pose(), outline()) for i in range(random.integers(1, 4)))
    return Scene(tuple(outline() for _ in range(random.integers(2, 4))), 4, things), pose()


@pytest.mark.parametrize("seed", range(16))
def test_it_agrees_with_every_beam_against_every_side(seed: int):
    random = np.random.default_rng(seed)
    scene, pose = invented(random)
    angle_min, increment = random.uniform(-7, 7), random.choice([-1, 1]) * random.uniform(0.02, 0.3)
    ranges, labels = sweep(scene, pose, angle_min, increment, 60, 12.0)
    expected, expected_labels = every_side(scene, pose, angle_min, increment, 60, 12.0)
    assert ranges == pytest.approx(expected, rel=1e-5, abs=1e-5)
    assert labels.tolist() == expected_labels.tolist()


def test_range_noise_has_the_stated_deviations():
    random = np.random.default_rng(1)
    near = with_noise(np.full(20_000, 5.0, np.float32), 30.0, random)
    far = with_noise(np.full(20_000, 20.0, np.float32), 30.0, random)
    assert (near.mean(), near.std()) == (pytest.approx(5.0, abs=0.001), pytest.approx(0.03, rel=0.03))
    assert (far.mean(), far.std()) == (pytest.approx(20.0, abs=0.002), pytest.approx(0.05, rel=0.03))


def test_noise_neither_adds_nor_removes_returns():
    measured = with_noise(np.array([29.999, np.inf, 0.001] * 1000, np.float32), 30.0, np.random.default_rng(1))
    assert np.isinf(measured[1::3]).all()
    assert measured[0::3].max() <= 30.0
    assert measured[2::3].min() >= 0.0


def test_ranges_are_multiples_of_the_resolution():
    measured = with_noise(np.linspace(0.5, 29, 1000, dtype=np.float32), 30.0, np.random.default_rng(1)) / TICK_M
    assert (measured == np.round(measured)).all()


# ---- errors: each kind alone, on a wall with a step, a pane and a dark body


def scan_with(errors: LaserErrors, static: tuple, surfaces: SceneSurfaces = MATT, seed: int = 1) -> Scan:
    laser = Laser(angle_min=-0.5, angle_increment=0.001, beams=1001, errors=errors)
    body = SceneObject(7, 0, SE2(3.0, 1.0), body_outline("pedestrian", 0.4, 0.4))
    scene = Scene(tuple(np.array(outline, np.float32) for outline in static), 1, (body,))
    return laser.scan(scene, 0, SE2(), np.random.default_rng(seed), surfaces)


def only(**errors: float) -> LaserErrors:
    return LaserErrors.model_validate(EXACT | errors)


def exact(static: tuple) -> Scan:
    return scan_with(only(), static)


def test_without_errors_the_ranges_are_true_to_the_resolution() -> None:
    found = exact((NEAR_WALL,))
    assert found.labels is not None
    ahead = 400  # at -0.1 rad
    assert found.ranges[ahead] == pytest.approx(4.0 / math.cos(0.1), abs=5e-4)
    assert found.labels[ahead] == 1
    assert np.isposinf(found.ranges[900])
    assert found.labels[900] == UNLABELLED


def test_noise_and_resolution_are_as_set() -> None:
    noisy = scan_with(LaserErrors(std_m=0.02, std_per_m=0.005, resolution_m=0.01), (NEAR_WALL,))
    error = noisy.ranges[:450] - exact((NEAR_WALL,)).ranges[:450]
    assert np.std(error) == pytest.approx(0.02 + 0.005 * 4.2, rel=0.15)
    assert abs(noisy.ranges[:450] / 0.01 - np.round(noisy.ranges[:450] / 0.01)).max() < 1e-3


def test_lost_returns_are_infinite_and_invalid_ones_are_nan() -> None:
    found = scan_with(only(lost=0.2, invalid=0.1), (NEAR_WALL,)).ranges[:450]
    assert np.isnan(found).mean() == pytest.approx(0.1, abs=0.05)
    assert np.isposinf(found).mean() == pytest.approx(0.9 * 0.2, abs=0.06)


def test_a_driver_may_report_nan_for_a_beam_without_a_return() -> None:
    usual, unknown = (scan_with(LaserErrors(lost=0.2, no_return=code), (NEAR_WALL,)).ranges for code in ("inf", "nan"))
    assert np.isposinf(usual).any()
    assert np.array_equal(np.where(np.isposinf(usual), np.nan, usual), unknown, equal_nan=True)


def test_errors_state_a_driver_only_if_it_reports_nan() -> None:
    assert "no_return" not in LaserErrors().model_dump()
    assert LaserErrors.model_validate(LaserErrors(no_return="nan").model_dump()).no_return == "nan"


def test_glass_gives_returns_from_the_front_and_else_the_surface_behind_it() -> None:
    glass = SceneSurfaces(glass={0})
    found = scan_with(only(glass_seen=0.0), (PANE, NEAR_WALL, FAR_WALL), glass)
    angle = -0.5 + 0.001 * np.arange(1001)
    facing, aside = np.abs(angle) < 0.1, (angle < -0.2)
    assert (found.ranges[facing] < 2.1).mean() == pytest.approx(0.9, abs=0.1)
    assert (found.ranges[aside] > 3.9).all()
    through = scan_with(only(glass_seen=0.0), (PANE, NEAR_WALL), glass)
    assert through.labels is not None
    assert (through.labels[(angle > 0.29) & (angle < 0.35)] == 0).all()  # the body behind the pane


def test_dark_cloth_is_lost_beyond_its_reach() -> None:
    errors = only(dark_reach=0.05)
    dark = scan_with(errors, (), SceneSurfaces(dark_tracks={7}))
    assert not np.isfinite(dark.ranges).any()
    assert np.isfinite(scan_with(errors, ()).ranges).any()


def test_a_mixed_pixel_is_between_both_surfaces_and_has_no_class() -> None:
    mixed, true = scan_with(only(mixed=1.0), (NEAR_WALL, FAR_WALL)), exact((NEAR_WALL, FAR_WALL))
    assert mixed.labels is not None
    changed = np.flatnonzero(np.abs(mixed.ranges - true.ranges) > 0.01)
    assert 1 <= len(changed) <= 4
    assert ((mixed.ranges[changed] > 2.5) & (mixed.ranges[changed] < 5.2)).all()
    assert (mixed.labels[changed] == UNLABELLED).all()
