"""The kalman tracker on scenes with ground truth: a laser in a corner, and moving discs as pedestrians."""

from __future__ import annotations

import numpy as np
import pytest

from gridtrack.common.grid import with_neighbours
from gridtrack.trackers.contract import StreamSpec
from gridtrack.trackers.model_free.kalman import KalmanEstimator, KalmanTracker
from gridtrack.trackers.model_free.settings import PipelineSettings
from gridtrack.trackers.training.weights import save_weights

from scenes import frames
from scenes.hall import GLIDING, GRID, OPEN, PERIOD_S, card, frame_of, walk


@pytest.fixture
def weights(tmp_path):
    """Weights for an empty hall; the pedestrians are discs with constant velocity."""
    path = tmp_path / "hall.toml"
    save_weights(path, card(velocity_memory_s=50.0), OPEN | {"residence": GLIDING})
    return path


@pytest.fixture
def tracker(weights):
    return KalmanTracker(StreamSpec(GRID, PERIOD_S, "hall", weights=weights), PipelineSettings())


def watch(tracker, *paths):
    """The forecast objects after each frame of pedestrians on `paths`."""
    seen = []
    for step, people in enumerate(zip(*paths, strict=True)):
        tracker.update(frame_of(list(people), step))
        seen.append(tracker.predict(0).objects)
    return seen


@pytest.mark.parametrize("lost", [{"mean": np.nan}, {"mean": 1e18}, {"covariance": np.inf}, {"covariance": np.nan}])
def test_a_track_with_a_diverged_estimator_continues_from_the_measurement(weights, lost):
    """Settings within the ranges of the search once had an estimate at 10^18 m, and an image without a size."""

    class Diverging(KalmanEstimator):
        updates = 0

        def update(self, pose, covariance):
            super().update(pose, covariance)
            self.updates += 1
            if self.updates == 10:
                self.reinitialise(self.mean + lost.get("mean", 0.0), self.covariance + lost.get("covariance", 0.0))

    class DivergingTracker(KalmanTracker):
        estimator = staticmethod(Diverging)

    tracker = DivergingTracker(StreamSpec(GRID, PERIOD_S, "hall", weights=weights), PipelineSettings())
    path = walk((3.0, -1.0), (0.0, 1.0), 31)
    seen = []
    for step, person in enumerate(path[:21]):
        tracker.update(frame_of([person], step))
        forecast = tracker.predict(10)
        assert np.isfinite(forecast.occupancy).all()
        seen.append(forecast.objects)
    assert [one.track for one in seen[-1]] == [seen[5][0].track]
    assert seen[-1][0].velocity == pytest.approx((0.0, 1.0), abs=0.2)
    most_probable = np.array(np.unravel_index(forecast.occupancy[10].argmax(), GRID.shape))
    assert np.abs(most_probable - GRID.cells_of(np.array(path[30:31]))[0][0]).max() <= 2
    assert tracker.recoveries == 2


@pytest.mark.parametrize("every", [2, 3])
def test_missed_frames_are_bridged(tracker, every):
    path = walk((3.0, -1.5), (0.0, 1.2), 37)
    for step in range(0, 25, every):
        tracker.update(frame_of([path[step]], step))
    objects = tracker.predict(0).objects
    assert len(objects) == 1
    assert objects[0].velocity == pytest.approx((0.0, 1.2), abs=0.15)
    ahead = tracker.predict(10).occupancy[10]
    came = frame_of([path[34]]).occupied
    assert ahead[came].mean() > 4 * ahead[with_neighbours(frame_of([path[24]]).occupied)].mean()


@pytest.mark.parametrize("velocity", [(0.8, 0.0), (0.0, 0.8), (-0.6, 0.6)])
def test_the_forecast_of_an_object_is_at_its_future_position(tracker, velocity):
    path = walk((3.0, -velocity[1]), velocity, 31)
    watch(tracker, path[:21])
    occupancy = tracker.predict(10).occupancy
    for step in (5, 10):
        came = frame_of([path[20 + step]])
        rows, columns = np.nonzero(came.occupied)
        mass = occupancy[step] - occupancy[step].min()
        centre = np.array([(mass.sum(0) * np.arange(60)).sum(), (mass.sum(1) * np.arange(60)).sum()]) / mass.sum()
        assert np.hypot(centre[0] - columns.mean(), centre[1] - rows.mean()) < 2.0  # cells; it moved by 8 of them


def test_a_forecast_grows_more_uncertain_and_stays_a_probability(tracker):
    watch(tracker, walk((3.0, -1.0), (0.0, 1.0), 20))
    occupancy = tracker.predict(10).occupancy
    assert occupancy.dtype == np.float32
    assert occupancy.min() >= 0.0
    assert occupancy.max() <= 1.0
    assert (np.diff(occupancy[2:].max(axis=(1, 2))) < 0).all()


def _sees(occluder, place) -> bool:
    alone, both = frame_of([occluder]), frame_of([occluder, place])
    return int(both.occupied.sum()) > int(alone.occupied.sum())


def test_a_hidden_object_is_still_forecast_and_a_vanished_one_is_not(tracker):
    standing, passing = [(1.5, 0.0)] * 45, walk((3.5, -2.0), (0.0, 0.9), 45)
    first_hidden = next(step for step in range(45) if not _sees(standing[step], passing[step]))
    watch(tracker, standing[: first_hidden + 3], passing[: first_hidden + 3])
    column, row = (np.array(passing[first_hidden + 3]) - np.array(GRID.origin)) // GRID.cell_m
    about = np.s_[1, int(row) - 4 : int(row) + 5, int(column) - 4 : int(column) + 5]
    assert tracker.predict(1).occupancy[about].sum() > 1.0
    for step in range(10):
        tracker.update(frame_of([], step))
    assert tracker.predict(1).objects == ()
    assert tracker.predict(1).occupancy.max() < 0.01


def test_the_box_of_an_object_is_as_large_as_the_cells_that_it_spans(tracker):
    frame = frame_of([])
    frame.occupied[30, 40], frame.occupied[30, 43] = True, True
    for step in range(8):
        tracker.update(frames.frame_of(frame.occupied, frame.visible, grid=GRID, second=0.1 * step))
    (one,) = tracker.predict(0).objects
    assert one.box[:2] == pytest.approx(GRID.cell_centres(frame.occupied).mean(axis=0), abs=0.05)
    assert one.box[3:] == pytest.approx((0.4, 0.1), abs=0.02)


def test_a_noisy_wall_initiates_no_track(tmp_path):
    rate, wall = OPEN["occupancy_rate"].copy(), OPEN["neighbourhood_rate"].copy()
    pillar = frame_of([], wall=True).occupied
    rate[pillar] = 0.9
    wall[with_neighbours(pillar)] = 1.0
    path = tmp_path / "hall.toml"
    save_weights(path, card(), OPEN | {"occupancy_rate": rate, "neighbourhood_rate": wall, "residence": GLIDING})
    tracker = KalmanTracker(StreamSpec(GRID, PERIOD_S, "hall", weights=path), PipelineSettings())
    for step in range(20):
        tracker.update(frame_of([], step, wall=step % 3 > 0))
    forecast = tracker.predict(5)
    assert forecast.objects == ()
    assert forecast.occupancy[5][pillar] == pytest.approx(0.9)


def test_a_standing_person_is_forecast_in_place_by_the_life_table(tmp_path):
    table = GLIDING.copy()
    table[20:] = 0.75
    path = tmp_path / "hall.toml"
    save_weights(path, card(static_above=0.99), OPEN | {"residence": table})
    tracker = KalmanTracker(StreamSpec(GRID, PERIOD_S, "hall", weights=path), PipelineSettings())
    frame = frame_of([(3.0, 1.0)])
    for step in range(30):
        tracker.update(frame)
        if step == 10:
            at_first = tracker.predict(10).occupancy[10][frame.occupied].mean()
    assert tracker.predict(10).occupancy[10][frame.occupied].mean() > at_first + 0.2


def test_step_0_is_the_observation(tracker):
    watch(tracker, walk((3.0, -1.0), (0.0, 1.0), 5))
    frame = frame_of([(3.0, -0.5)])
    tracker.update(frame)
    assert np.array_equal(tracker.predict(3).occupancy[0][frame.visible], frame.occupied[frame.visible])


def test_restarts_of_a_smoother_are_counted_until_the_reset(weights):
    import gtsam

    from gridtrack.trackers.model_free.factor_graph import LAG_S, FactorGraphTracker

    save_weights(weights, card().model_copy(update={"tracker": "factor-graph"}), OPEN | {"residence": GLIDING})
    tracker = FactorGraphTracker(StreamSpec(GRID, PERIOD_S, "hall", weights=weights), PipelineSettings())
    path = walk((3.0, -1.0), (0.0, 1.0), 12)
    watch(tracker, path[:10])
    assert tracker.recoveries == 0
    knows_nothing = gtsam.IncrementalFixedLagSmoother(LAG_S)
    tracker.tracks[0].estimator.estimators[0]._smoother = knows_nothing
    seen = watch(tracker, path[10:])
    assert tracker.recoveries == 1
    assert seen[-1][0].track == 0
    tracker.reset(seed=0)
    assert tracker.recoveries == 0
