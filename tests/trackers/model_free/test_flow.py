"""Flow of the model-free trackers: the velocities of cells where tracks are predicted to be."""

import math

import numpy as np
import pytest

pytest.importorskip("filterpy")
from gridtrack.common.grid import GridSpec
from gridtrack.trackers.model_free.background import BackgroundMap
from gridtrack.trackers.model_free.forecast import draw_flow, flow_of
from gridtrack.trackers.model_free.kalman import KalmanEstimator
from gridtrack.trackers.model_free.pipeline import Pipeline
from gridtrack.trackers.model_free.residence import table_shape
from gridtrack.trackers.model_free.settings import PipelineSettings

from scenes.street import box, frame_of, legs

GRID, PERIOD_S = GridSpec(64, 0.25, (0.0, -8.0)), 0.125


def drawn(boxes, means, reach_m):
    flow = np.full((1, 2, 8, 8), np.nan, np.float32)
    draw_flow(
        flow, np.array(boxes, float), np.array(means, float)[:, None], np.array(reach_m)[:, None], np.zeros(2), 1.0
    )
    return flow[0]


def test_a_cell_has_the_velocity_of_the_nearest_body_within_reach():
    boxes = [(-0.5, -0.5, 0.5, 0.5)] * 2
    flow = drawn(boxes, [(1.5, 3.5, 0, 1, 0, 0), (5.3, 3.5, 0, 0, -2, 0)], [1.6, 2.0])
    assert flow[0, 3].tolist() == pytest.approx([1, 1, 1, 0, 0, 0, 0, 0]), "the one at column 3 is nearer to the second"
    assert flow[1, 3].tolist() == pytest.approx([0, 0, 0, -2, -2, -2, -2, -2])
    assert np.isnan(flow[:, 6:, 0]).all()
    assert np.isnan(flow[:, 7]).all()


def test_a_turning_body_moves_each_cell_as_a_rigid_one():
    flow = drawn([(-3.0, -0.5, 3.0, 0.5)], [(4.5, 4.5, math.pi / 2, 0, 1, 0.5)], [0.1])
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


def test_without_tracks_no_cell_has_a_velocity():
    place = BackgroundMap(*np.zeros((2, *GRID.shape), np.float32))
    empty = Pipeline(
        GRID, PERIOD_S, place, np.zeros(table_shape(PERIOD_S), np.float32), PipelineSettings(), KalmanEstimator
    )
    assert np.isnan(flow_of(empty.tracks, 3, empty.regimes.models[0], GRID)).all()
