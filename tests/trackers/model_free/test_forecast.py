"""Drawing uncertain bodies into the grid, against hand-computed masses, and the velocities of cells."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gridtrack.common.grid import GridSpec
from gridtrack.trackers.model_free.background import BackgroundMap
from gridtrack.trackers.model_free.forecast import draw_flow, flow_of
from gridtrack.trackers.model_free.kalman import KalmanEstimator
from gridtrack.trackers.model_free.pipeline import Pipeline
from gridtrack.trackers.model_free.rasterise import WINDOW_SIGMAS, Motions, Resident, Surfaces, draw_track, draw_tracks
from gridtrack.trackers.model_free.residence import table_shape
from gridtrack.trackers.model_free.settings import PipelineSettings

from scenes.street import box, frame_of, legs


def gauss(low, high, mean, sigma):
    return 0.5 * (math.erf((high - mean) / sigma / math.sqrt(2)) - math.erf((low - mean) / sigma / math.sqrt(2)))


NOWHERE = np.empty((0, 2))
KEPT = math.erf(WINDOW_SIGMAS / math.sqrt(2)) ** 2
"""Share of the mass of a blurred point within the blur window."""


def unclassed(occupancy):
    """Semantics and classes of a tracker without classes."""
    steps, rows, columns = occupancy.shape
    return np.zeros((steps, 0, rows, columns), np.float32), np.zeros(0, np.float32)


def drawn(offsets, poses, covariances, weights=None, size=61, existence=1.0):
    """The occupancy of a body (n+1, M, M), without resident returns."""
    steps = len(poses)
    occupancy = np.zeros((steps, size, size), np.float32)
    weights = np.ones(len(offsets)) if weights is None else weights
    still = np.zeros((0, steps), np.float32)
    draw_track(
        occupancy,
        np.asarray(offsets, float),
        weights,
        np.asarray(poses, float)[None],
        np.asarray(covariances, float)[None],
        np.ones((1, steps)),
        NOWHERE,
        0.3,
        still,
        np.full(steps, existence),
        *unclassed(occupancy),
    )
    return occupancy


def test_a_blurred_point_is_the_gaussian_mass_of_every_cell():
    image = drawn([(0.0, 0.0)], [(10.5, 12.5, 0.0)], [np.diag([1.0, 4.0])], size=21)[0]
    assert image[12, 10] == pytest.approx(gauss(10, 11, 10.5, 1) * gauss(12, 13, 12.5, 2), rel=1e-5)
    assert image[15, 9] == pytest.approx(gauss(9, 10, 10.5, 1) * gauss(15, 16, 12.5, 2), rel=1e-5)


@pytest.mark.parametrize("covariance", [[[4.0, 0.0], [0.0, 9.0]], [[6.0, 3.5], [3.5, 4.0]], [[3.0, -2.0], [-2.0, 5.0]]])
def test_the_blur_has_the_covariance_and_keeps_the_mass(covariance):
    image = drawn([(0.0, 0.0)], [(30.2, 30.7, 0.0)], [covariance])[0].astype(float)
    rows, columns = np.mgrid[:61, :61] + 0.5
    assert KEPT < image.sum() <= 1.0
    image /= image.sum()
    assert [(image * columns).sum(), (image * rows).sum()] == pytest.approx([30.2, 30.7], abs=0.025)
    spread = np.cov(np.stack([columns.ravel(), rows.ravel()]), aweights=image.ravel(), ddof=0)
    assert spread == pytest.approx(np.array(covariance) + np.eye(2) / 12, rel=0.1, abs=0.25)  # the tails are cut


@pytest.mark.parametrize(
    "covariance", [[[1e12, 0.0], [0.0, 0.0]], [[5e11, 5e11], [5e11, 5e11]], [[9e9, 0.0], [0.0, 1e3]]]
)
def test_a_position_less_certain_than_the_window_is_not_drawn(covariance):
    """Settings within the ranges of the search once asked for an image of 10^12 pixels."""
    assert drawn([(0.0, 0.0)], [(30.5, 30.5, 0.0)], [covariance])[0].max() == 0.0


def test_a_body_turns_with_its_heading():
    image = drawn([(5.0, 0.0)], [(30.5, 30.5, 0.0), (30.5, 30.5, math.pi / 2)], np.zeros((2, 2, 2)))
    assert np.unravel_index(image[0].argmax(), (61, 61)) == (30, 35)
    assert np.unravel_index(image[1].argmax(), (61, 61)) == (35, 30)


def test_points_of_one_cell_add_up_to_certainty_at_most():
    pose, sharp = [(30.5, 30.5, 0.0)], np.zeros((1, 2, 2))
    assert drawn([(0.0, 0.0)] * 2, pose, sharp, np.array([0.5, 0.4]))[0].sum() == pytest.approx(0.9, rel=1 - KEPT)
    assert drawn([(0.0, 0.0)] * 2, pose, sharp, np.array([0.9, 0.9]))[0].sum() == pytest.approx(1.0, rel=1 - KEPT)


def test_alternative_motions_share_the_mass_of_the_body():
    occupancy = np.zeros((1, 9, 9), np.float32)
    poses = np.array([[[2.5, 4.5, 0.0]], [[6.5, 4.5, 0.0]]])
    still = np.zeros((0, 1), np.float32)
    body = np.zeros((1, 2)), np.ones(1), poses, np.zeros((2, 1, 2, 2)), np.array([[0.7], [0.3]])
    draw_track(occupancy, *body, NOWHERE, 0.3, still, np.ones(1), *unclassed(occupancy))
    inside = gauss(4, 5, 4.5, 0.2) ** 2
    assert occupancy[0, 4, [2, 4, 6]] == pytest.approx([0.7 * inside, 0.0, 0.3 * inside], abs=1e-5)


def test_resident_returns_are_drawn_in_place_with_the_weight_of_each_step():
    occupancy = np.zeros((2, 21, 21), np.float32)
    place = np.array([[8.5, 12.5]])
    nothing = np.empty((0, 2)), np.empty(0), np.full((1, 2, 3), 10.5), np.zeros((1, 2, 2, 2)), np.zeros((1, 2))
    draw_track(
        occupancy, *nothing, place, 0.6, np.array([[1.0, 0.5]], np.float32), np.array([1.0, 0.8]), *unclassed(occupancy)
    )
    mass = gauss(8, 9, 8.5, 0.6) * gauss(12, 13, 12.5, 0.6)
    assert occupancy[:, 12, 8] == pytest.approx([mass, 0.4 * mass], rel=1e-5)


def test_mass_outside_the_grid_is_not_drawn():
    image = drawn([(0.0, 0.0)], [(0.0, 4.5, 0.0), (-500.0, 4.5, 0.0)], np.tile(np.diag([1.0, 0.09]), (2, 1, 1)), size=8)
    assert image[0].sum() == pytest.approx(0.5, rel=1 - KEPT)
    assert image[1].sum() == 0.0


def test_a_track_is_combined_with_the_background_by_noisy_or():
    occupancy = np.full((1, 9, 9), 0.2, np.float32)
    body = np.zeros((1, 2)), np.ones(1), np.array([[[4.5, 4.5, 0.0]]]), np.zeros((1, 1, 2, 2)), np.ones((1, 1))
    draw_track(occupancy, *body, NOWHERE, 0.3, np.zeros((0, 1), np.float32), np.array([0.5]), *unclassed(occupancy))
    inside = gauss(4, 5, 4.5, 0.2) ** 2
    assert occupancy[0, 4, 4] == pytest.approx(1 - 0.8 * (1 - 0.5 * inside), rel=1e-5)
    assert occupancy[0, 0, 0] == pytest.approx(0.2)


def test_tracks_drawn_together_equal_tracks_drawn_one_by_one():
    random = np.random.default_rng(0)
    sizes, seen, steps = [3, 1, 5], [2, 4, 1], 4
    bounds, shown = np.cumsum([0, *sizes]), np.cumsum([0, *seen])
    surfaces = Surfaces(random.uniform(-2, 2, (9, 2)), random.uniform(0, 1, 9), bounds)
    covariances = random.uniform(0.2, 2.0, (3, 2, steps, 1, 1)) * np.eye(2)
    motions = Motions(random.uniform(3, 18, (3, 2, steps, 3)), covariances, random.uniform(0, 0.5, (3, 2, steps)))
    resident = Resident(random.uniform(2, 19, (7, 2)), shown, random.uniform(0, 1, (7, steps)).astype(np.float32), 0.5)
    existence, classes = random.uniform(0, 1, (3, steps)), random.uniform(0, 1, (3, 2)).astype(np.float32)
    together, apart = np.zeros((2, steps, 21, 21), np.float32)
    of_all, of_one_by_one = np.zeros((2, steps, 2, 21, 21), np.float32)
    draw_tracks(together, surfaces, motions, resident, existence, of_all, classes)
    for t in range(3):
        own, points = slice(*bounds[t : t + 2]), slice(*shown[t : t + 2])
        body = surfaces.offsets[own], surfaces.weights[own]
        motion = motions.poses[t], motions.covariances[t], motions.weights[t]
        newest = resident.points[points], resident.blur, resident.probability[points]
        draw_track(apart, *body, *motion, *newest, existence[t], of_one_by_one, classes[t])
    assert together.max() > 0.3
    assert together.tolist() == apart.tolist()
    assert of_all.tolist() == of_one_by_one.tolist()


GRID, PERIOD_S = GridSpec(64, 0.25, (0.0, -8.0)), 0.125


def drawn_flow(boxes, means, reach_m):
    flow = np.full((1, 2, 8, 8), np.nan, np.float32)
    draw_flow(
        flow, np.array(boxes, float), np.array(means, float)[:, None], np.array(reach_m)[:, None], np.zeros(2), 1.0
    )
    return flow[0]


def test_a_cell_has_the_velocity_of_the_nearest_body_within_reach():
    boxes = [(-0.5, -0.5, 0.5, 0.5)] * 2
    flow = drawn_flow(boxes, [(1.5, 3.5, 0, 1, 0, 0), (5.3, 3.5, 0, 0, -2, 0)], [1.6, 2.0])
    assert flow[0, 3].tolist() == pytest.approx([1, 1, 1, 0, 0, 0, 0, 0]), "the one at column 3 is nearer to the second"
    assert flow[1, 3].tolist() == pytest.approx([0, 0, 0, -2, -2, -2, -2, -2])
    assert np.isnan(flow[:, 6:, 0]).all()
    assert np.isnan(flow[:, 7]).all()


def test_a_turning_body_moves_each_cell_as_a_rigid_one():
    flow = drawn_flow([(-3.0, -0.5, 3.0, 0.5)], [(4.5, 4.5, math.pi / 2, 0, 1, 0.5)], [0.1])
    assert flow[:, 7, 4].tolist() == pytest.approx([-0.5 * 3, 1.0]), "three metres ahead, along y"
    assert np.isnan(flow[:, 4, 7]).all()


def test_walker_and_car_have_their_velocities_where_they_will_be():
    place = BackgroundMap(np.full(GRID.shape, 1e-2, np.float32), np.zeros(GRID.shape, np.float32))
    residence = np.full(table_shape(PERIOD_S), 0.2, np.float32)
    pipeline = Pipeline(GRID, PERIOD_S, place, residence, PipelineSettings(), KalmanEstimator)
    for step in range(24):
        t = step * PERIOD_S
        bodies = [legs((6.0, -3.0 + 1.2 * t)), box(3.0, 1.6, (9.0, 2.0 - 0.9 * t), -np.pi / 2)]
        pipeline.update(frame_of(bodies, step, GRID))
    flow = flow_of(pipeline.tracks, 8, pipeline.regimes.models[0], GRID)
    assert (flow.shape, flow.dtype) == ((9, 2, *GRID.shape), np.float16)
    for ahead, nearly in ((0, 0.6), (8, 0.4)):  # the model's velocities fade with time
        t = (23 + ahead) * PERIOD_S
        for (x, y), speed in (((6.0, -3.0 + 1.2 * t), 1.2), ((9.0, 2.0 - 0.9 * t), -0.9)):
            vx, vy = flow[ahead, :, int((y + 8.0) / 0.25), int(x / 0.25)].tolist()
            assert vx == pytest.approx(0.0, abs=0.2)
            assert nearly < vy / speed < 1.25
    assert np.isnan(flow[:, :, 0, 0]).all()
