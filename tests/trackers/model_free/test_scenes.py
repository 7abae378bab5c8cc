"""Both model-free trackers on scenes with ground truth: occlusion, crowds, stopping, departure, velocities."""

from __future__ import annotations

import numpy as np
import pytest

from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.simulation.laser import Laser
from gridtrack.trackers.model_free.background import BackgroundMap
from gridtrack.trackers.model_free.factor_graph import FactorGraphEstimator
from gridtrack.trackers.model_free.kalman import KalmanEstimator
from gridtrack.trackers.model_free.pipeline import Pipeline
from gridtrack.trackers.model_free.residence import table_shape
from gridtrack.trackers.model_free.settings import PipelineSettings
from gridtrack.trackers.model_free.shape import rotation

from scenes.frames import scanned

GRID = GridSpec(100, 0.2, (-2.0, -10.0))
PERIOD_S = 0.125
LASER = Laser(angle_min=-np.pi / 2, angle_increment=np.pi / 720, beams=721, range_min=0.02, range_max=25.0)
PERSON = np.array([(0.25 * np.cos(a), 0.15 * np.sin(a)) for a in np.linspace(0, 2 * np.pi, 16, endpoint=False)])
CAR = np.array([(-2.2, -0.9), (2.2, -0.9), (2.2, 0.9), (-2.2, 0.9)])
POST = np.array([(-0.2, -0.2), (0.2, -0.2), (0.2, 0.2), (-0.2, 0.2)])
WALKERS = {"link_m": 0.25, "surface_noise_m": 0.1, "reach_m": 0.45, "velocity_memory_s": 20.0, "initial_speed": 1.5}
TRAFFIC = {"link_m": 0.6, "surface_noise_m": 0.1, "reach_m": 0.6, "velocity_memory_s": 40.0, "initial_speed": 5.0}
ESTIMATORS = pytest.mark.parametrize("estimator", [KalmanEstimator, FactorGraphEstimator])


def seen(bodies, random=None, raw=False) -> GridFrame:
    """The frame of a laser at the origin, of bodies (outline (N, 2), x, y, heading); with `random`, noise of 0.03 m."""
    outlines = [outline @ rotation(heading).T + [x, y] for outline, x, y, heading in bodies]
    noise = None if random is None else random.normal(0.0, 0.03, LASER.beams)
    return scanned(LASER, outlines, GRID, noise=noise, raw=raw)


def pipeline_of(estimator, **settings) -> Pipeline:
    """A pipeline with an empty map and without resident returns."""
    place = BackgroundMap(np.full(GRID.shape, 1e-3, np.float32), np.zeros(GRID.shape, np.float32))
    residence = np.zeros(table_shape(PERIOD_S), np.float32)
    return Pipeline(GRID, PERIOD_S, place, residence, PipelineSettings(**settings), estimator)


def at(pipeline, x, y):
    """The confirmed track with the boundary nearest to a position, and the distance."""
    tracks = [track for track in pipeline.tracks if track.confirmed]
    distances = [np.linalg.norm(track.boundary - np.array([x, y]), axis=1).min() for track in tracks]
    nearest = int(np.argmin(distances))
    return tracks[nearest], distances[nearest]


@ESTIMATORS
def test_an_object_through_two_seconds_of_full_occlusion_is_the_same_track(estimator):
    pipeline = pipeline_of(estimator, **WALKERS)
    truck = np.array([(-1.6, -0.3), (1.6, -0.3), (1.6, 0.3), (-1.6, 0.3)])
    hidden, identities = 0, []
    for step in range(64):
        y = -4.0 + 1.2 * step * PERIOD_S
        frame = seen([(truck, 4.0, 0.0, np.pi / 2), (PERSON, 6.0, y, 0.0)])
        alone = seen([(truck, 4.0, 0.0, np.pi / 2)])
        pipeline.update(frame)
        hidden += np.array_equal(frame.occupied, alone.occupied)
        if step > 10:
            track, distance = at(pipeline, 6.0, y)
            assert distance < 1.0
            identities.append(track.identity)
    assert hidden * PERIOD_S >= 2.0
    assert len(set(identities)) == 1


@ESTIMATORS
@pytest.mark.parametrize("association", ["hungarian", "jcbb"])
def test_two_people_who_cross_keep_their_identities(estimator, association):
    """Their distance is half a metre, and their cells touch."""
    pipeline = pipeline_of(estimator, **WALKERS, association=association)
    first, second = set(), set()
    for step in range(56):
        way = 1.2 * (step * PERIOD_S - 3.5)
        pipeline.update(seen([(PERSON, 5.0, way, np.pi / 2), (PERSON, 5.6, -way, np.pi / 2)]))
        if step > 10 and abs(way) > 1.0:
            first.add(at(pipeline, 5.0, way)[0].identity)
            second.add(at(pipeline, 5.6, -way)[0].identity)
    assert len(first) == len(second) == 1
    assert first != second


@ESTIMATORS
def test_a_car_that_parks_becomes_background_and_one_that_leaves_is_tracked_again(estimator):
    pipeline = pipeline_of(estimator, **TRAFFIC, background_merge_s=5.0, adaptation_s=3.0)
    parked = seen([(CAR, 8.0, 0.0, np.pi / 2)])
    for _ in range(64):
        pipeline.update(parked)
    assert pipeline.tracks == []
    assert pipeline.forecast(8)[8][parked.occupied].mean() > 0.4
    for step in range(40):
        y = (step * PERIOD_S) ** 2 / 2.0
        pipeline.update(seen([(CAR, 8.0, y, np.pi / 2)]))
        if step == 24:
            track, distance = at(pipeline, 7.1, y)
            assert distance < 0.5
            assert track.estimator.mean[4] > 2.0
    assert pipeline.forecast(8)[8][parked.occupied].mean() < 0.1


@ESTIMATORS
def test_a_person_merges_into_a_group_and_out_of_it(estimator):
    pipeline = pipeline_of(estimator, **WALKERS, background_merge_s=100.0, track_merge_s=1.0)
    count = []
    for step in range(120):
        y = 2.5 - min(2.0, 0.8 * step * PERIOD_S) + max(0.0, 0.8 * (step - 80) * PERIOD_S)
        pipeline.update(seen([(PERSON, 5.0, 0.0, np.pi / 2), (PERSON, 5.0, y, np.pi / 2)]))
        if step < 10:
            continue
        count.append(len({at(pipeline, 4.85, place)[0].identity for place in (0.0, y)}))
    assert set(count[:5]) == {2}
    assert set(count[50:70]) == {1}
    assert set(count[102:]) == {2}


@ESTIMATORS
def test_a_vehicle_seen_in_two_pieces_becomes_one(estimator):
    """A post hides the middle of the vehicle in all frames."""
    pipeline = pipeline_of(estimator, **TRAFFIC | {"link_m": 0.5, "reach_m": 0.3}, track_merge_s=0.5)
    count = []
    for step in range(24):
        y = -1.4 + 0.8 * step * PERIOD_S
        frame = seen([(POST, 3.0, 0.0, 0.0), (CAR, 8.0, y, np.pi / 2)])
        rows = np.flatnonzero(frame.occupied[:, GRID.cells_of(np.array([[7.15, 0.0]]))[0][0, 1]])
        assert np.diff(rows).max() * GRID.cell_m > 0.6
        pipeline.update(frame)
        if step > 3:
            count.append(len({at(pipeline, 7.1, y + offset)[0].identity for offset in (-1.8, 1.8)}))
    assert set(count[:3]) == {2}
    assert set(count[-4:]) == {1}


@ESTIMATORS
def test_two_legs_that_part_are_one_person(estimator):
    """They are within reach of each other, but not linked."""
    pipeline = pipeline_of(estimator, **WALKERS | {"link_m": 0.2, "reach_m": 0.5})
    for step in range(24):
        apart = 0.25 * np.sin(np.pi * step / 12) ** 2
        y = -1.5 + 1.0 * step * PERIOD_S
        pipeline.update(seen([(0.6 * PERSON, 3.0 - apart, y, 0.0), (0.6 * PERSON, 3.0 + apart, y + apart, 0.0)]))
        assert len(pipeline.tracks) == 1, step


@ESTIMATORS
def test_the_hidden_part_of_a_visible_body_is_forecast(estimator):
    pipeline = pipeline_of(estimator, **TRAFFIC, shape_memory_s=2.0)
    screen = np.array([(-0.1, -0.8), (0.1, -0.8), (0.1, 0.8), (-0.1, 0.8)])
    for step in range(21):
        y = -2.5 + 1.5 * step * PERIOD_S
        frame = seen([(screen, 3.0, 0.9, 0.0), (CAR, 8.0, y, np.pi / 2)])
        pipeline.update(frame)
    front = GRID.cells_of(np.column_stack([np.full(6, 7.1), y + np.linspace(0.5, 2.0, 6)]))[0]
    rear = GRID.cells_of(np.column_stack([np.full(6, 7.1), y - np.linspace(1.2, 2.0, 6)]))[0]
    assert not frame.visible[tuple(front.T)].any()
    assert frame.occupied[tuple(rear.T)].mean() > 0.8
    assert pipeline.forecast(0)[0][tuple(front.T)].mean() > 0.3


@ESTIMATORS
@pytest.mark.parametrize(("raw", "limit"), [(True, 0.1), (False, 0.2)])
@pytest.mark.parametrize("turn_rate", [0.0, 0.25])
def test_the_velocity_of_a_car_is_known(estimator, raw, limit, turn_rate):
    """Root-mean-square error after a second at 8 Hz, with the noise of the laser, straight on and in a turn."""
    errors = []
    for seed in range(3):
        random = np.random.default_rng(seed)
        surface = 0.05 if raw else 0.1
        settings = TRAFFIC | {"surface_noise_m": surface, "acceleration": 0.2, "turn_acceleration": 0.2}
        pipeline = pipeline_of(estimator, **settings, position_noise_m=0.02 if raw else 0.05, shape_memory_s=2.0)
        x, y, heading = 8.0, -5.0, np.pi / 2
        for step in range(24):
            velocity = 3.0 * np.array([np.cos(heading), np.sin(heading)])
            pipeline.update(seen([(CAR, x, y, heading)], random, raw))
            if step >= 8:
                track, _ = at(pipeline, x, y)
                errors.append(track.estimator.mean[3:5] - reference_velocity(track, velocity, turn_rate, x, y))
            x, y = np.array([x, y]) + velocity * PERIOD_S
            heading += turn_rate * PERIOD_S
    assert np.sqrt((np.array(errors) ** 2).mean()) < limit


def reference_velocity(track, velocity, turn_rate, x, y):
    """The velocity of the body at the position of the track; the body rotates about its own centre."""
    lever = track.estimator.mean[:2] - [x, y]
    return velocity + turn_rate * np.array([-lever[1], lever[0]])
