"""Classes of the model-free trackers: features of tracks, the prior of cells, and both in a forecast."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from gridtrack.trackers.model_free.classes import FEATURES, ClassFilter, features_of, mean_log_prior
from gridtrack.trackers.model_free.forecast import attribute, normalise, weight_by_cell_prior
from gridtrack.trackers.model_free.rasterise import draw_track
from gridtrack.trackers.model_free.tracks import Window
from gridtrack.trackers.model_free.training import TrackSamples, cell_log_loss, cell_prior_of, fit_mixtures

from scenes.street import CAR, GRID, PEDESTRIAN, box, frame_of, legs

WINDOW = Window(GRID)


def track_of(points, velocity, identity=0, unseen=0):
    """The attributes of a track that determine its class."""
    mean = np.array([*points.mean(axis=0), 0.0, *velocity, 0.0])
    return SimpleNamespace(
        identity=identity, returns=points, estimator=SimpleNamespace(mean=mean), unseen=unseen, existence=1.0
    )


def some_people_and_cars(seed=0, count=80):
    """One frame of each track: cars and pedestrians with random sizes, positions and speeds."""
    draw, rows, cells = np.random.default_rng(seed), [], []
    for number in range(2 * count):
        kind, heading, at = number % 2, draw.uniform(0, 2 * math.pi), draw.uniform((3.0, -4.0), (10.0, 4.0))
        body = box(draw.normal(4.3, 0.3), 1.8, at, heading) if kind == CAR else legs(at, draw.uniform(0.1, 0.5))
        speed = abs(draw.normal(7.0, 3.0) if kind == CAR else draw.normal(1.2, 0.4))
        velocity = speed * np.array([math.cos(heading), math.sin(heading)])
        rows.append(features_of([track_of(body, velocity)], frame_of([]), WINDOW)[0])
        cells.append([len(body), 0] if kind == PEDESTRIAN else [0, len(body)])
    return TrackSamples(np.array(rows), np.arange(2 * count), np.array(cells), [np.array([0])] * 2 * count)


def anywhere(kinds=2, grid=GRID):
    return np.full((kinds, *grid.shape), 1.0 / kinds)


@pytest.fixture(scope="module")
def model():
    return fit_mixtures(some_people_and_cars(), anywhere(), components=2, seed=0)


# Features of tracks


def test_a_box_of_car_size_at_8_m_per_s_is_a_car_and_two_legs_at_walking_speed_a_pedestrian(model):
    car = track_of(box(4.4, 1.8, (6.0, 1.0), 0.3), (8 * math.cos(0.3), 8 * math.sin(0.3)), identity=7)
    walker = track_of(legs((5.0, -2.0)), (0.0, 1.2), identity=9)
    classes = ClassFilter(model, GRID)
    classes.observe([car, walker], frame_of([]), WINDOW)
    found = classes.posteriors([car, walker])
    assert found.dtype == np.float32
    assert found.sum(axis=1) == pytest.approx([1.0, 1.0])
    assert found[0, CAR] > 0.99
    assert found[1, PEDESTRIAN] > 0.99


def test_features_are_extents_speed_and_range():
    track = track_of(np.array([(3.0, 4.0), (5.0, 4.0), (3.0, 4.5), (5.0, 4.5)]), (0.0, 2.0))
    other = track_of(np.array([(4.0, 5.0), (9.0, 5.0)]), (1.0, 0.0))
    found = features_of([track, other], frame_of([]), WINDOW)
    assert found[1] == pytest.approx(np.log([5.2, 5.2, 0.2, 1.3, 1.0 + math.hypot(6.5, 5.0)]))
    expected = [2.2, 0.7, 2.2, 2.3, 1.0 + math.hypot(4.0, 4.25)]
    assert len(FEATURES) == found.shape[1]
    assert found[0] == pytest.approx(np.log(expected))


def test_extents_do_not_depend_on_the_heading():
    nothing = frame_of([]), WINDOW
    found = [
        features_of([track_of(box(4.0, 1.6, (6.0, 0.0), turn), (math.cos(turn), math.sin(turn)))], *nothing)[0, :3]
        for turn in (0.0, 1.0, 2.5)
    ]
    assert found[1] == pytest.approx(found[0])
    assert found[2] == pytest.approx(found[0])


def test_densities_equal_scipys_gaussians(model):
    features = some_people_and_cars(seed=1).features
    expected = np.zeros((len(features), 2))
    for k in range(2):
        factor = np.linalg.inv(model.whitening[k])
        for share, mean in zip(model.mixture_weights[k], model.means[k], strict=True):
            expected[:, k] += share * multivariate_normal(mean, factor.T @ factor).pdf(features)
    assert model.log_densities(features) == pytest.approx(np.log(expected))


def test_a_hidden_track_keeps_its_class_and_every_frame_in_view_counts(model):
    walker, crowd = track_of(legs((5.0, 0.0)), (0.0, 1.2)), track_of(box(1.4, 0.6, (5.0, 0.0)), (0.0, 1.2))
    classes = ClassFilter(model, GRID)
    densities = [model.log_densities(features_of([each], frame_of([]), WINDOW))[0] for each in (walker, crowd)]
    for each in (walker, crowd, walker):
        classes.observe([each], frame_of([]), WINDOW)
    before = classes.posteriors([walker])
    place = np.log([[0.5, 0.5]])
    assert before == pytest.approx(model.posteriors((2 * densities[0] + densities[1])[None] / 3, place), abs=1e-6)
    walker.unseen = 5
    classes.observe([walker], frame_of([]), WINDOW)
    assert (classes.posteriors([walker]) == before).all()
    classes.observe([], frame_of([]), WINDOW)
    with pytest.raises(KeyError):
        classes.posteriors([walker])


def test_tracks_with_equal_features_have_the_cell_prior_with_its_power(model):
    place = anywhere()
    place[:, :, :30], place[:, :, 30:] = [[[0.9]], [[0.1]]], [[[0.2]], [[0.8]]]
    left, right = track_of(legs((2.0, 0.0)), (0.0, 1.0)), track_of(legs((10.0, 0.0)), (0.0, 1.0))
    by_place = model._replace(powers=np.array([0.0, 1.0]), cell_prior=place)
    log_prior = mean_log_prior([left, right], by_place.cell_prior, WINDOW)
    assert by_place.posteriors(np.zeros((2, 2)), log_prior) == pytest.approx(np.array([[0.9, 0.1], [0.2, 0.8]]))
    by_frequency = by_place._replace(powers=np.zeros(2))
    assert by_frequency.posteriors(np.zeros((2, 2)), log_prior) == pytest.approx(np.tile(model.frequency, (2, 1)))


def test_probabilities_are_calibrated_on_other_tracks(model):
    fresh = some_people_and_cars(seed=2, count=400)
    found = model.posteriors(model.log_densities(fresh.features), np.log(np.full((800, 2), 0.5)))
    assert cell_log_loss(found, fresh.cells) < 0.1
    assert cell_log_loss(found[:, ::-1], fresh.cells) > 1.0


def test_a_class_without_samples_has_the_distribution_of_all_samples():
    learned = some_people_and_cars()
    third = learned._replace(cells=np.pad(learned.cells, ((0, 0), (0, 1))))
    model = fit_mixtures(third, anywhere(3), components=4, seed=0)
    assert np.isfinite(model.log_densities(learned.features)).all()
    assert 0.0 < model.frequency[2] < 0.01


def test_the_mean_over_a_lifetime_ends_with_the_track():
    tracked = TrackSamples(np.zeros((5, 5)), np.array([0, 0, 1, 1, 1]), np.zeros((5, 2), np.int64), [])
    values = np.array([[1.0], [3.0], [10.0], [20.0], [60.0]])
    assert tracked.mean_over_life(values).ravel().tolist() == [1.0, 2.0, 10.0, 15.0, 30.0]


# Prior of cells


def test_the_cell_prior_weights_its_own_returns_over_its_surroundings_and_the_site():
    count = np.zeros((2, 80, 80))
    count[0, 5:8, 5:8], count[1, 5, 6] = 30.0, 60.0
    count[1, 30:34, 30:34] = 50.0
    place = cell_prior_of(count, 0.2)
    assert place.sum(axis=0) == pytest.approx(np.ones((80, 80)))
    assert place.min() > 0.0
    assert place[1, 5, 6] == pytest.approx(2 / 3, abs=0.02)
    assert place[0, 6, 6] > 0.98
    assert place[0, 9, 9] > 0.7
    assert place[1, 36, 36] > 0.95
    assert place[1, 5, 78] == pytest.approx(860 / (860 + 270), abs=0.02)


# Semantics of a forecast


def test_semantics_are_weighted_by_the_occupancy_of_background_and_tracks():
    occupancy = np.full((1, 9, 9), 0.2, np.float32)
    place = np.zeros((2, 9, 9), np.float32)
    place[PEDESTRIAN] = 1.0
    semantics = weight_by_cell_prior(occupancy, place)
    body = np.zeros((1, 2)), np.ones(1), np.array([[[4.5, 4.5, 0.0]]]), np.zeros((1, 1, 2, 2)), np.ones((1, 1))
    still, classes = np.zeros((0, 1), np.float32), np.array([0.25, 0.75], np.float32)
    draw_track(occupancy, *body, np.empty((0, 2)), 0.3, still, np.array([0.5]), semantics, classes)
    normalise(semantics)
    shown = 0.5 * math.erf(0.5 / 0.2 / math.sqrt(2)) ** 2
    assert semantics[0, :, 4, 4] == pytest.approx([(0.2 + 0.25 * shown) / (0.2 + shown), 0.75 * shown / (0.2 + shown)])
    assert semantics[0, :, 0, 0].tolist() == [1.0, 0.0]


def test_an_observed_return_has_the_classes_of_its_track():
    semantics, place = np.zeros((2, *GRID.shape), np.float32), anywhere().astype(np.float32)
    body, behind = legs((5.0, 0.0)), legs((5.0, 4.0))
    frame = frame_of([body, np.array([(9.0, 3.0)])])
    tracks = [track_of(body, (0.0, 1.0)), track_of(behind, (0.0, 1.0), unseen=1)]
    attribute(semantics, place, frame.occupied, tracks, np.array([[0.1, 0.9], [1.0, 0.0]], np.float32), GRID)
    (own, hidden, other), _ = GRID.cells_of(np.array([body[0], behind[0], (9.0, 3.0)]))
    assert semantics[:, own[0], own[1]] == pytest.approx([0.1, 0.9])
    assert semantics[:, hidden[0], hidden[1]].tolist() == [0.0, 0.0]
    assert semantics[:, other[0], other[1]] == pytest.approx([0.5, 0.5])
