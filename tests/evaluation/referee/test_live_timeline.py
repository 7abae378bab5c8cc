"""Deadlines in real time: a tracker that is busy misses frames, and its newest forecast in time is kept."""

from __future__ import annotations

import numpy as np
import pytest

from gridtrack.evaluation.referee.deadline import Timeline
from gridtrack.evaluation.referee.live_timeline import Delivered, ForecastStore, LiveTimeline, StoredForecasts
from gridtrack.trackers.contract import Forecast

from scenes.scored_cells import frame

FRAME = frame(*np.zeros((2, 4, 4)))


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
