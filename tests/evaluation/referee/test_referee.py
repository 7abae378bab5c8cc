"""The referee: which forecasts are scored against which frames, and the bound of its memory."""

import weakref

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gridtrack.common.errors import RecordingError
from gridtrack.common.grid import GridSpec
from gridtrack.evaluation.referee.kinds import KindsOfWindow, Regions
from gridtrack.evaluation.referee.referee import (
    WARM_UP,
    Delivery,
    KeptMoments,
    Schedule,
    _size_of,
    moments,
    scored_forecasts,
)
from gridtrack.evaluation.referee.strata import CELL_KINDS
from gridtrack.evaluation.runs.fit_regions import score_in_process
from gridtrack.evaluation.scores.cells import Tally, count_cells
from gridtrack.evaluation.scores.f1 import f1_of
from gridtrack.evaluation.scores.thresholds import half
from gridtrack.trackers.contract import Forecast

from scenes.scored_cells import frame

GRID = GridSpec(8, 1.0)
STEPS = 4
LOOKBACK = 10
"""Frames of the second before, by which motion is found."""
ALL_DYNAMIC = Regions(GRID, KindsOfWindow(np.full(GRID.shape, CELL_KINDS.index("dynamic"), np.uint8)))


def random_frame(index):
    occupied = np.random.default_rng(index).random(GRID.shape) < 0.3
    return frame(np.ones(GRID.shape), occupied, index * 100_000_000)


class FakeStream:
    name, sha256, grid, period_s, site, classes = "fake.mcap", "0" * 64, GRID, 0.1, "nowhere", ()

    def __init__(self, frames):
        self.frames = frames

    def __iter__(self):
        return map(random_frame, range(self.frames))

    def __len__(self):
        return self.frames


class Seer:
    """A tracker that knows the future frames, and forecasts frame t+n at step n."""

    def __init__(self, stream):
        self.frames, self.calls = list(stream), []

    def reset(self, seed):
        self.index = -1
        self.calls.append(("reset", seed))

    def update(self, frame):
        self.index += 1
        assert frame.stamp_ns == self.frames[self.index].stamp_ns
        self.calls.append(("update", self.index))

    def predict(self, steps):
        self.calls.append(("predict", self.index))
        frames = self.frames[self.index : self.index + steps + 1]
        return Forecast(np.stack([frame.occupied for frame in frames]).astype(np.float32))


def delivery(stream):
    return Delivery(moments(stream, ALL_DYNAMIC), lambda: None)


def f1_per_step(stream, tracker, every=3):
    tally = Tally.empty(STEPS)
    for scored in scored_forecasts(tracker, delivery(stream), Schedule(len(stream), STEPS, every), seed=7):
        tally.add(count_cells(scored.forecast.occupancy, scored.targets, scored.region_maps, scored.ages))
    return f1_of(tally.confusion(half(STEPS).bins))[:, 0]


def test_a_tracker_that_knows_the_future_scores_one_at_every_step():
    stream = FakeStream(60)
    assert f1_per_step(stream, Seer(stream)).tolist() == [1.0] * (STEPS + 1)


def test_only_the_step_with_the_correct_frame_scores_one():
    class KnowsStepTwo(Seer):
        def predict(self, steps):
            occupancy = np.zeros((steps + 1, *GRID.shape), np.float32)
            occupancy[2] = super().predict(steps).occupancy[2]
            return Forecast(occupancy)

    stream = FakeStream(60)
    assert f1_per_step(stream, KnowsStepTwo(stream)).tolist() == [0.0, 0.0, 1.0, 0.0, 0.0]


def test_warm_up_and_tail_are_delivered_and_not_forecast_from():
    stream = FakeStream(40)
    tracker = Seer(stream)
    scored = list(scored_forecasts(tracker, delivery(stream), Schedule(40, STEPS, 5), seed=7))
    assert tracker.calls[0] == ("reset", 7)
    assert [i for call, i in tracker.calls if call == "update"] == list(range(40))
    assert [i for call, i in tracker.calls if call == "predict"] == [20, 25, 30, 35]
    assert [one.stamp_ns // 100_000_000 for one in scored] == [20, 25, 30, 35]


@given(frames=st.integers(0, 90), steps=st.integers(0, 30), every=st.integers(1, 20))
def test_the_schedule_expects_as_many_forecasts_as_are_due(frames, steps, every):
    schedule = Schedule(frames, steps, every)
    due = [index for index in range(frames) if schedule.due(index)]
    assert len(due) == schedule.expected
    assert all(index >= WARM_UP and index + steps <= frames - 1 for index in due)


def test_no_more_than_a_horizon_of_frames_is_kept():
    cells = []

    class Watched(FakeStream):
        def __iter__(self):
            for one in super().__iter__():
                cells.append(weakref.ref(one.visible))
                yield one

    class Blind(Seer):
        def update(self, frame):
            assert sum(alive() is not None for alive in cells) <= LOOKBACK + STEPS + 3

        def predict(self, steps):
            return Forecast(np.zeros((steps + 1, *GRID.shape), np.float32))

    for scored in scored_forecasts(Blind([]), delivery(Watched(200)), Schedule(200, STEPS, 1), seed=0):
        assert len(scored.frames) == STEPS + 1
        del scored
    assert len(cells) == 200


class ReadStream(FakeStream):
    """Counts how often it is read."""

    passes = 0

    def __iter__(self):
        self.passes += 1
        return super().__iter__()


def test_a_short_stretch_is_read_once_for_all_trackers():
    stream = ReadStream(60)
    kept = KeptMoments(stream, ALL_DYNAMIC)
    first, second = (list(scored_forecasts(Seer(FakeStream(60)), kept, Schedule(60, STEPS, 3), 7)) for _ in range(2))
    assert stream.passes == 1
    assert len(first) == len(second) == Schedule(60, STEPS, 3).expected
    for one, other in zip(first, second, strict=True):
        assert all(mine is yours for mine, yours in zip(one.targets, other.targets, strict=True))
        assert one.region_maps is other.region_maps


@pytest.mark.parametrize("room", [1, 30])
def test_a_stretch_that_takes_too_much_memory_is_read_for_each_tracker(room, monkeypatch):
    """Its first frame says it, or a later one that is larger."""
    stream = ReadStream(60)
    size = _size_of(next(iter(moments(stream, ALL_DYNAMIC))))
    monkeypatch.setattr("gridtrack.evaluation.referee.referee.MOST_KEPT_BYTES", room * size)
    if room > 1:
        monkeypatch.setattr(ReadStream, "__len__", lambda self: 1)
    kept, stream.passes = KeptMoments(stream, ALL_DYNAMIC), 0
    assert [len(list(kept)) for _ in range(2)] == [60, 60]
    assert stream.passes == 2


def test_a_pass_that_ended_early_keeps_nothing_and_passes_at_the_same_time_keep_once():
    stream = ReadStream(60)
    kept = KeptMoments(stream, ALL_DYNAMIC)
    next(iter(kept))
    together = [(one.frame.stamp_ns, other.frame.stamp_ns) for one, other in zip(kept, kept, strict=True)]
    assert ([one == other for one, other in together], stream.passes) == ([True] * 60, 3)
    assert [next(iter(kept)) is next(iter(kept)), stream.passes] == [True, 3]


def test_the_digest_covers_every_frame_in_order():
    def digest(frames):
        delivered = delivery(frames)
        list(delivered)
        return delivered.digest, delivered.frames

    class Swapped(FakeStream):
        def __iter__(self):
            frames = list(super().__iter__())
            return iter([frames[1], frames[0], *frames[2:]])

    assert digest(FakeStream(5)) == digest(FakeStream(5))
    assert len({digest(stream)[0] for stream in (FakeStream(5), FakeStream(6), Swapped(5))}) == 3


def test_scoring_in_this_process_agrees_with_the_referee():
    stream = FakeStream(60)
    score = score_in_process(Seer(stream), stream, STEPS, ALL_DYNAMIC)
    assert set(score.f1) == {"visible", "dynamic", "static", "in-motion", "standing"}
    assert score.f1["visible"].tolist() == [1.0] * (STEPS + 1)
    assert score.log_loss["visible"] == pytest.approx(-np.log(0.999))


def test_a_stretch_too_short_to_score_is_refused():
    with pytest.raises(RecordingError, match="too few"):
        score_in_process(Seer(FakeStream(20)), FakeStream(20), STEPS, ALL_DYNAMIC)
