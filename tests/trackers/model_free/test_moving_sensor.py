"""The model-free trackers behind a sensor that moves: tracks and background stay where they are in the world."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec, Shift, rolled
from gridtrack.trackers.model_free.background import OUTSIDE_MAP, BackgroundMap, fit_background
from gridtrack.trackers.model_free.factor_graph import FactorGraphEstimator
from gridtrack.trackers.model_free.forecast import objects
from gridtrack.trackers.model_free.kalman import KalmanEstimator
from gridtrack.trackers.model_free.pipeline import Pipeline
from gridtrack.trackers.model_free.residence import table_shape
from gridtrack.trackers.model_free.settings import PipelineSettings

from scenes import robot_street
from scenes.scrolling import WORLD, scrolled
from scenes.street import box, frame_of, legs

GRID, PERIOD_S = GridSpec(64, 0.25, (0.0, -8.0)), 0.125
ESTIMATORS = pytest.mark.parametrize("estimator", [KalmanEstimator, FactorGraphEstimator])
INNER = np.s_[..., 12:-12, 12:-12]
"""The cells that no shift of these tests moves out of the window."""


def street(step: int):
    """A wall, a walker and a car, at positions of the standing window."""
    t = step * PERIOD_S
    wall = np.stack([np.linspace(5.0, 12.0, 60), np.full(60, 3.6)], axis=1)
    return frame_of([wall, legs((6.0, -3.0 + 1.2 * t)), box(3.0, 1.6, (9.0, 2.0 - 0.9 * t), -np.pi / 2)], step, GRID)


def pipeline_of(estimator, rate=1e-2, **settings) -> Pipeline:
    place = BackgroundMap(np.full(GRID.shape, rate, np.float32), np.zeros(GRID.shape, np.float32))
    residence = np.full(table_shape(PERIOD_S), 0.2, np.float32)
    return Pipeline(GRID, PERIOD_S, place, residence, PipelineSettings(**settings), estimator)


def to_and_fro(step: int) -> Shift:
    """By several cells between frames, at most 9 cells from the start."""
    return Shift(round(9 * np.sin(0.4 * step)), round(-9 * np.sin(0.3 * step)))


@ESTIMATORS
def test_a_scrolling_window_and_a_standing_one_give_the_same_forecast_of_the_same_world(estimator):
    standing, moving = pipeline_of(estimator), pipeline_of(estimator)
    for step in range(32):
        frame, shift = street(step), to_and_fro(step)
        standing.update(frame)
        moving.update(scrolled(frame, shift, GRID))
    assert shift != (0, 0)
    expected = rolled(standing.forecast(12), shift, 0.0)
    found = moving.forecast(12)
    assert found[12][INNER].max() > 0.2
    # not equal: a wide blur is drawn in pixels of several cells, counted from the corner of the window
    np.testing.assert_allclose(found[INNER], expected[INNER], atol=5e-3)
    offset = np.array([shift.columns, shift.rows]) * GRID.cell_m
    pairs = zip(objects(standing.tracks, standing.window), objects(moving.tracks, moving.window), strict=True)
    for one, other in pairs:
        assert one.track == other.track
        assert other.box[:2] == pytest.approx(one.box[:2] - offset, abs=1e-3)
        assert other.velocity == pytest.approx(one.velocity, abs=1e-3)


def test_a_cell_that_comes_in_was_never_seen_and_one_that_left_is_forgotten():
    pipeline = pipeline_of(KalmanEstimator)
    for step, shift in enumerate([Shift(), Shift(0, 3), Shift(0, 0)]):
        pipeline.update(scrolled(street(step), shift, GRID))
        hidden = pipeline.background.hidden_s
        if step == 1:
            assert (hidden[:, :-3] == 0.0).all()
            assert np.isinf(hidden[:, -3:]).all()
    assert (pipeline.background.hidden_s == 0.0).all()
    assert (pipeline.background._record.visible[:, :3] == 1.0).all()
    assert (pipeline.background._record.visible[:, 3:] > 2.0).all()


def test_a_map_of_the_site_stays_in_the_world_and_comes_back_with_it():
    rate = np.random.default_rng(0).uniform(0.0, 0.9, GRID.shape).astype(np.float32)
    walls = np.zeros(GRID.shape, np.float32)
    walls[:, 40] = 0.99
    residence = np.zeros(table_shape(PERIOD_S), np.float32)
    pipeline = Pipeline(GRID, PERIOD_S, BackgroundMap(rate, walls), residence, PipelineSettings(), KalmanEstimator)
    for step, columns in enumerate([0, 50, 0]):
        shift = Shift(0, columns)
        pipeline.update(scrolled(street(step), shift, GRID))
        found = pipeline.background
        assert np.array_equal(found.occupancy_rate, rolled(rate, shift, np.median(rate)))
        assert np.array_equal(found._walls, rolled(walls, shift, OUTSIDE_MAP) > 0.5)


@ESTIMATORS
def test_a_shift_larger_than_the_window_leaves_nothing(estimator):
    outside = BackgroundMap(np.full(GRID.shape, 1e-2, np.float32), np.full(GRID.shape, OUTSIDE_MAP, np.float32))
    pipeline = pipeline_of(estimator)
    fresh = Pipeline(GRID, PERIOD_S, outside, pipeline.residence, pipeline.settings, estimator)
    for step in range(12):
        pipeline.update(scrolled(street(step), Shift(), GRID))
    assert len(pipeline.tracks) == 3
    beyond = replace(street(12), world_T_grid=SE2(WORLD.x + 2e6, WORLD.y))
    for each in (pipeline, fresh):
        each.update(beyond)
        assert each.tracks == []
    np.testing.assert_array_equal(pipeline.forecast(4), fresh.forecast(4))


# A drive past walls and people, without a map


def robot_of(estimator) -> Pipeline:
    place = BackgroundMap(*np.float32([[[0.02]], [[OUTSIDE_MAP]]]) * np.ones((2, *robot_street.GRID.shape), np.float32))
    residence = np.full(table_shape(robot_street.PERIOD_S), 0.2, np.float32)
    settings = PipelineSettings(link_m=0.45, initial_speed=1.5)
    return Pipeline(robot_street.GRID, robot_street.PERIOD_S, place, residence, settings, estimator)


@ESTIMATORS
def test_walls_and_posts_that_come_into_view_of_a_driving_robot_do_not_move(estimator):
    """With an error of the pose of 1.5 cm; at most one false moving object in two frames."""
    pipeline, fast, seen = robot_of(estimator), [], []
    for now in robot_street.drive(20.0, pose_noise_m=0.015):
        pipeline.update(now.frame)
        found = objects(pipeline.tracks, pipeline.window)
        fast.append(sum(np.hypot(*one.velocity) > 0.5 for one in found))
        seen.append(pipeline.forecast(8)[8][now.frame.occupied].mean())
    assert np.mean(fast[24:]) < 0.5
    assert np.mean(seen[24:]) > 0.7


@ESTIMATORS
def test_people_who_walk_beside_a_driving_robot_have_their_velocities_in_the_world(estimator):
    """Over three drives: of one, the errors are of two tracks only."""
    walkers = {(0.8, 0.0): lambda t: (5.0 + 0.8 * t, 2.0), (-0.9, 0.3): lambda t: (20.0 - 0.9 * t, -3.0 + 0.3 * t)}
    errors, positions = [], []
    for seed in range(3):
        pipeline = robot_of(estimator)
        for now in robot_street.drive(12.0, tuple(walkers.values()), pose_noise_m=0.015, seed=seed):
            pipeline.update(now.frame)
            for velocity, walker in walkers.items():
                place = np.array(walker(now.time_s)) - now.corner
                if now.time_s < 3.0 or not in_view_of(now.frame, place):
                    continue
                found = objects(pipeline.tracks, pipeline.window)
                near = min(found, key=lambda one: np.hypot(*(one.box[:2] - place)))
                positions.append(np.hypot(*(near.box[:2] - place)))
                errors.append(np.hypot(*(near.velocity - velocity)))
    assert len(errors) > 180
    assert np.quantile(positions, 0.9) < 0.4
    assert np.median(errors) < 0.25


def in_view_of(frame, place) -> bool:
    """Whether a place of the window (2,), metres, has returns around it."""
    (row, column), inside = (each[0] for each in robot_street.GRID.cells_of(place[None]))
    return bool(inside) and frame.occupied[max(row - 2, 0) : row + 3, max(column - 2, 0) : column + 3].any()


def test_a_map_that_was_learned_from_a_moving_sensor_knows_no_place():
    frames = [now.frame for now in robot_street.drive(3.0)]
    fitted, moves = fit_background([frames], robot_street.GRID.cell_m)
    assert moves
    assert (fitted.neighbourhood_rate == OUTSIDE_MAP).all()
    assert np.ptp(fitted.occupancy_rate) == 0.0
    assert fitted.occupancy_rate[0, 0] == pytest.approx(
        sum(f.occupied.sum() for f in frames) / sum(f.visible.sum() for f in frames), rel=1e-4
    )
