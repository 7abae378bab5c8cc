"""Deadlines: the frames that a busy tracker misses, the age of its newest forecast, and both in real time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec, LabelledFrame
from gridtrack.evaluation.referee.deadline import Costs, DeadlineTracker, Timeline, spare_steps, timeline
from gridtrack.evaluation.referee.kinds import KindsOfWindow, Regions
from gridtrack.evaluation.referee.live_timeline import Delivered, ForecastStore, LiveTimeline, StoredForecasts
from gridtrack.evaluation.referee.referee import Delivery, Schedule, moments, scored_forecasts
from gridtrack.trackers.contract import Forecast

from scenes import scored_cells

PERIOD_MS = 100.0
GRID = GridSpec(2, 1.0)


def of(update_periods: float, predict_periods: float = 0.0, frames: int = 12) -> Timeline:
    return timeline(frames, PERIOD_MS, Costs((update_periods * PERIOD_MS,), (predict_periods * PERIOD_MS,)))


@pytest.mark.parametrize(
    ("update", "predict", "newest"),
    [
        pytest.param(0.0, 0.0, range(12), id="without delay it forecasts at once"),
        pytest.param(0.3, 0.6, [-1, *range(11)], id="faster than a period it is one frame late"),
        pytest.param(0.5, 0.5, [-1, *range(11)], id="finished exactly at a frame it is in time and free"),
    ],
)
def test_a_tracker_that_needs_no_more_than_a_period_misses_no_frame(
    update: float, predict: float, newest: list[int]
) -> None:
    assert of(update, predict).missed == 0
    assert of(update, predict).newest.tolist() == list(newest)


def test_a_tracker_that_needs_one_and_a_half_periods_misses_every_second_frame() -> None:
    busy = of(1.0, 0.5, frames=9)
    assert busy.accepted.tolist() == [True, False] * 4 + [True]
    # the forecast made from frame 0 is there at 1.5 periods, that from frame 2 at 3.5, ...
    assert busy.newest.tolist() == [-1, -1, 0, 0, 2, 2, 4, 4, 6]


@given(
    st.lists(st.tuples(st.floats(0.0, 400.0), st.floats(0.0, 400.0)), min_size=1, max_size=7),
    st.integers(1, 60),
)
def test_the_timeline_is_monotonic(costs: list[tuple[float, float]], frames: int) -> None:
    """Checked frame by frame against a clock in whole microseconds, written the slow way."""
    rounded = [(round(u, 3), round(p, 3)) for u, p in costs]
    found = timeline(frames, PERIOD_MS, Costs(tuple(u for u, _ in rounded), tuple(p for _, p in rounded)))
    free, taken, delivered = 0, [], []
    for k in range(frames):
        now = k * 100_000
        if free <= now:
            update, predict = rounded[len(delivered) % len(rounded)]
            free = now + round(update * 1000) + round(predict * 1000)
            delivered.append((free, k))
            taken.append(k)
        assert found.newest[k] == max((f for at, f in delivered if at <= now), default=-1)
    assert np.flatnonzero(found.accepted).tolist() == taken


def test_the_highest_rate_follows_from_the_99th_percentile() -> None:
    costs = Costs(tuple([10.0] * 98 + [40.0] * 2), tuple([10.0] * 100))
    assert costs.highest_rate_hz == pytest.approx(1000.0 / 50.0)
    assert timeline(1000, 50.0, costs).missed == 0
    assert timeline(1000, 49.0, costs).missed > 0


def test_the_spare_steps_cover_the_age_of_the_oldest_forecast() -> None:
    assert spare_steps(0.0, PERIOD_MS, 20) == 0
    assert spare_steps(30.0, PERIOD_MS, 20) == 2
    for busy in (30.0, 100.0, 170.0, 320.0):
        stale = timeline(50, PERIOD_MS, Costs((busy,), (0.0,)))
        assert (np.arange(50) - stale.newest)[10:].max() <= spare_steps(busy, PERIOD_MS, 20)
    assert spare_steps(1e6, PERIOD_MS, 20) == 20


def frame(index: int, x: float = 0.0) -> GridFrame:
    return scored_cells.frame(*np.zeros((2, *GRID.shape)), index * 100_000_000, SE2(x))


class Frames:
    """A FrameSource of frames that show nothing."""

    name, sha256, site, classes, grid, period_s = "frames", "", "here", (), GRID, PERIOD_MS / 1e3

    def __init__(self, frames: int) -> None:
        self.frames = frames

    def __len__(self) -> int:
        return self.frames

    def __iter__(self) -> Iterator[GridFrame]:
        return map(frame, range(self.frames))

    def labelled(self) -> Iterator[LabelledFrame]:
        raise NotImplementedError


def delivery(frames: int) -> Delivery:
    return Delivery(moments(Frames(frames), Regions(GRID, KindsOfWindow(np.zeros(GRID.shape, np.uint8)))), lambda: None)


class Clockwork:
    """Forecasts a hundredth of the number of frame t+n at step n; records the frames that it receives."""

    def reset(self, seed: int) -> None:
        self.updates: list[int] = []
        self.predictions: list[int] = []

    def update(self, given: GridFrame) -> None:
        self.updates.append(given.stamp_ns // 100_000_000)

    def predict(self, steps: int) -> Forecast:
        self.predictions.append(self.updates[-1])
        numbers = (self.updates[-1] + np.arange(steps + 1, dtype=np.float32)) / 100
        return Forecast(np.broadcast_to(numbers[:, None, None], (steps + 1, *GRID.shape)).copy())


def answers(kept: Timeline, steps: int, reach: int, frames: int = 60) -> tuple[Clockwork, list[list[int]]]:
    tracker = Clockwork()
    schedule = Schedule(frames, steps, 5)
    on_time = DeadlineTracker(tracker, kept, schedule, reach, GRID.cell_m)
    scored = scored_forecasts(on_time, delivery(frames), schedule, seed=0)
    steps_read = [np.rint(100 * one.forecast.occupancy[:, 0, 0]).astype(int).tolist() for one in scored]
    return tracker, steps_read


def test_the_newest_forecast_is_read_at_the_requested_stamp() -> None:
    tracker, steps_read = answers(of(1.0, 0.5, frames=60), steps=4, reach=7)
    assert steps_read == [list(range(t, t + 5)) for t in range(20, 56, 5)]
    assert tracker.updates == list(range(0, 60, 2))
    # at frame 20 the forecast of frame 18 is delivered, at 25 that of 22; no other is requested
    assert tracker.predictions == [18, 22, 28, 32, 38, 42, 48, 52]


def test_a_forecast_that_is_too_short_repeats_its_last_step() -> None:
    _, steps_read = answers(of(1.0, 0.5, frames=60), steps=4, reach=4)
    assert steps_read[0] == [20, 21, 22, 22, 22]
    assert steps_read[1] == [25, 26, 26, 26, 26]


def test_before_the_first_delivered_forecast_no_cell_is_called_occupied() -> None:
    tracker, steps_read = answers(of(22.0, 0.0, frames=60), steps=4, reach=8)
    assert steps_read[0] == [0] * 5
    assert steps_read[1][0] == 8  # made at frame 0, requested at 25 for frame 25: beyond its eight steps
    assert tracker.updates == [0, 22, 44]


def test_a_forecast_that_is_delivered_late_is_read_in_the_window_of_now() -> None:
    class Corner(Clockwork):
        def predict(self, steps: int) -> Forecast:
            corner = np.zeros((steps + 1, *GRID.shape), np.float32)
            corner[:, 0, 1] = 0.9
            semantics = np.stack([corner, 1.0 - corner], axis=1)
            return Forecast(corner, semantics)

    made_at = 20
    newest = np.where(np.arange(23) < made_at, -1, made_at)
    late = DeadlineTracker(Corner(), Timeline(np.arange(23) == made_at, newest), Schedule(23, 1, 1), 4, GRID.cell_m)
    late.reset(0)
    read = []
    for index in range(23):
        late.update(frame(index, max(0.0, index - made_at)))
        if index >= made_at:
            read.append(late.predict(1))
    assert read[0].occupancy[0].tolist() == [[0.0, pytest.approx(0.9)], [0.0, 0.0]]
    assert read[1].occupancy[0].tolist() == [[pytest.approx(0.9), 0.0], [0.0, 0.0]], "entering cells are free"
    assert not read[2].occupancy.any()
    for one in read:
        assert one.semantics is not None
        np.testing.assert_allclose(one.semantics.sum(axis=1), 1.0, atol=1e-6)
    assert read[1].semantics[0, :, 0, 1].tolist() == [0.5, 0.5]


FRAME = scored_cells.frame(*np.zeros((2, 4, 4)))


def forecast(value: float) -> Forecast:
    return Forecast(np.full((3, 4, 4), value, np.float32))


def test_a_busy_tracker_misses_frames_and_a_forecast_is_in_time_before_the_next_frame() -> None:
    live = LiveTimeline()
    for number, delivers in enumerate([0, 1, None, None, 2, None]):
        live.present(FRAME, has_deadline=number > 0)
        if number in (0, 1, 2, 5):
            taken = live.take()
            assert taken is not None
            assert taken.number == number
        if delivers is not None:
            live.deliver(delivers, forecast(delivers / 10))
        live.close(number)
    # frame 2 is delivered after frame 4 was presented: frames 3 and 4 are missed, and 4 has the forecast in time
    assert live.timeline.accepted.tolist() == [True, True, True, False, False, True]
    assert live.timeline.newest.tolist() == [0, 1, 1, 1, 2, 2]
    assert live.missed == live.timed.missed == 2
    assert live.timed.newest.tolist() == [0, 0, 0, 1, 1]


def test_a_deadline_is_closed_once_and_a_tracker_that_left_is_given_nothing() -> None:
    live = LiveTimeline()
    live.present(FRAME, has_deadline=True)
    live.deliver(0, forecast(0.5))
    first = live.close(0)
    live.deliver(0, forecast(0.7))
    assert live.close(0) is first
    assert live.frames == 1
    live.leave()
    assert live.wait_until_free(0.0)
    live.present(FRAME, has_deadline=True)
    live.end()
    live.take()
    assert live.take() is None
    assert live.missed == 1


def test_all_forecasts_before_the_failure_are_stored(tmp_path) -> None:
    store = ForecastStore(tmp_path)
    with_classes = Forecast(
        np.random.default_rng(1).random((3, 4, 4), np.float32), np.full((3, 2, 4, 4), 0.5, np.float32)
    )
    store.add(Delivered(0, forecast(0.25)))
    store.add(Delivered(2, with_classes))
    store.add(Delivered(2, forecast(0.9)))
    assert list(tmp_path.iterdir()) == []
    timeline = Timeline(np.array([True, False, True, True]), np.array([0, 0, 2, 2]))
    stored = StoredForecasts(store, timeline, (3, ValueError("died")))
    stored.reset(0)
    stored.update(FRAME)
    assert (stored.predict(2).occupancy == 0.25).all()
    stored.update(FRAME)
    np.testing.assert_array_equal(stored.predict(2).occupancy, with_classes.occupancy)
    np.testing.assert_array_equal(stored.predict(2).semantics, with_classes.semantics)
    with pytest.raises(ValueError, match="died"):
        stored.update(FRAME)
    store.close()


def test_a_timeline_lasts_to_the_end_of_a_longer_recording() -> None:
    whole = Timeline(np.array([True, True]), np.array([0, 1])).lasting(4)
    assert (whole.accepted.tolist(), whole.newest.tolist()) == ([True, True, False, False], [0, 1, 1, 1])
    assert Timeline(np.zeros(0, np.bool_), np.zeros(0, np.int64)).lasting(2).newest.tolist() == [-1, -1]
