"""Errors of a laser: each kind alone, on a wall with a step, a pane and a dark body."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gridtrack.common.geometry import SE2
from gridtrack.common.scan import Scan
from gridtrack.common.scene import UNLABELLED, Scene, SceneObject
from gridtrack.simulation.bodies import body_outline
from gridtrack.simulation.laser import MATT, Laser, LaserErrors, SceneSurfaces

EXACT = {"std_m": 0.0, "glass_seen": 1.0, "dark_reach": 1.0}
PANE = ((2.0, -3.0), (2.02, -3.0), (2.02, 3.0), (2.0, 3.0))
NEAR_WALL, FAR_WALL = (
    ((4.0, -9.0), (4.2, -9.0), (4.2, 0.0), (4.0, 0.0)),
    ((5.0, 0.0), (5.2, 0.0), (5.2, 9.0), (5.0, 9.0)),
)


def scan(errors: LaserErrors, static: tuple, surfaces: SceneSurfaces = MATT, seed: int = 1) -> Scan:
    laser = Laser(angle_min=-0.5, angle_increment=0.001, beams=1001, errors=errors)
    body = SceneObject(7, 0, SE2(3.0, 1.0), body_outline("pedestrian", 0.4, 0.4))
    scene = Scene(tuple(np.array(outline, np.float32) for outline in static), 1, (body,))
    return laser.scan(scene, 0, SE2(), np.random.default_rng(seed), surfaces)


def exact(static: tuple) -> Scan:
    return scan(LaserErrors.model_validate(EXACT), static)


def test_without_errors_the_ranges_are_true_to_the_resolution() -> None:
    found = exact((NEAR_WALL,))
    assert found.labels is not None
    ahead = 400  # at -0.1 rad
    assert found.ranges[ahead] == pytest.approx(4.0 / math.cos(0.1), abs=5e-4)
    assert found.labels[ahead] == 1
    assert np.isposinf(found.ranges[900])
    assert found.labels[900] == UNLABELLED


def test_noise_and_resolution_are_as_set() -> None:
    noisy = scan(LaserErrors(std_m=0.02, std_per_m=0.005, resolution_m=0.01), (NEAR_WALL,))
    error = noisy.ranges[:450] - exact((NEAR_WALL,)).ranges[:450]
    assert np.std(error) == pytest.approx(0.02 + 0.005 * 4.2, rel=0.15)
    assert abs(noisy.ranges[:450] / 0.01 - np.round(noisy.ranges[:450] / 0.01)).max() < 1e-3


def test_lost_returns_are_infinite_and_invalid_ones_are_nan() -> None:
    found = scan(LaserErrors.model_validate(EXACT | {"lost": 0.2, "invalid": 0.1}), (NEAR_WALL,)).ranges[:450]
    assert np.isnan(found).mean() == pytest.approx(0.1, abs=0.05)
    assert np.isposinf(found).mean() == pytest.approx(0.9 * 0.2, abs=0.06)


def test_a_pane_is_seen_from_the_front_and_else_what_is_behind_it() -> None:
    glass = SceneSurfaces(glass={0})
    found = scan(LaserErrors.model_validate(EXACT | {"glass_seen": 0.0}), (PANE, NEAR_WALL, FAR_WALL), glass)
    angle = -0.5 + 0.001 * np.arange(1001)
    facing, aside = np.abs(angle) < 0.1, (angle < -0.2)
    assert (found.ranges[facing] < 2.1).mean() == pytest.approx(0.9, abs=0.1)
    assert (found.ranges[aside] > 3.9).all()
    through = scan(LaserErrors.model_validate(EXACT | {"glass_seen": 0.0}), (PANE, NEAR_WALL), glass)
    assert through.labels is not None
    assert (through.labels[(angle > 0.29) & (angle < 0.35)] == 0).all()  # the body behind the pane


def test_dark_cloth_is_lost_beyond_its_reach() -> None:
    errors = LaserErrors.model_validate(EXACT | {"dark_reach": 0.05})
    dark = scan(errors, (), SceneSurfaces(dark_tracks={7}))
    assert not np.isfinite(dark.ranges).any()
    assert np.isfinite(scan(errors, ()).ranges).any()


def test_a_mixed_pixel_lies_between_both_surfaces_and_has_no_class() -> None:
    mixed, true = (
        scan(LaserErrors.model_validate(EXACT | {"mixed": 1.0}), (NEAR_WALL, FAR_WALL)),
        exact((NEAR_WALL, FAR_WALL)),
    )
    assert mixed.labels is not None
    changed = np.flatnonzero(np.abs(mixed.ranges - true.ranges) > 0.01)
    assert 1 <= len(changed) <= 4
    assert ((mixed.ranges[changed] > 2.5) & (mixed.ranges[changed] < 5.2)).all()
    assert (mixed.labels[changed] == UNLABELLED).all()
