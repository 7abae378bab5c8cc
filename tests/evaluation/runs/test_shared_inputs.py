"""Regions of recordings that the jobs of a run share: found once, and kept for few recordings."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from gridtrack.common.errors import RecordingError
from gridtrack.evaluation.engines.engine import Interrupted
from gridtrack.evaluation.referee.splits import EvaluationSplit
from gridtrack.evaluation.runs.jobs import SharedInputs
from gridtrack.evaluation.runs.plan import resolve
from gridtrack.recordings.stream import GridStream


class Split:
    """A split with the one method that counts here, and how often it was called."""

    def __init__(self, name, error=None):
        self.whole, self.found, self.error = name, 0, error
        self.started, self.proceed = threading.Event(), threading.Event()
        self.proceed.set()

    def regions(self, check):
        self.found += 1
        self.started.set()
        self.proceed.wait(10)
        if self.error:
            raise self.error
        return f"regions of {self.whole} ({self.found})"


@pytest.fixture
def shared(settings, tmp_path):
    return lambda jobs: SharedInputs(settings("persistence"), lambda text: None, tmp_path, jobs)


def test_jobs_that_need_regions_at_the_same_time_wait_for_the_first(shared):
    inputs, split = shared(2), Split("hall")
    split.proceed.clear()
    with ThreadPoolExecutor(2) as threads:
        first = threads.submit(inputs.regions_of, split)
        assert split.started.wait(10)
        second = threads.submit(inputs.regions_of, split)
        split.proceed.set()
        assert first.result() == second.result() == "regions of hall (1)"


def test_regions_are_kept_for_as_many_recordings_as_jobs_run(shared):
    inputs = shared(2)
    splits = [Split(name) for name in "abc"]
    for split in (splits[0], splits[1], splits[0], splits[2], splits[0]):
        inputs.regions_of(split)
    assert [split.found for split in splits] == [1, 1, 1]
    inputs.regions_of(splits[1])
    assert splits[1].found == 2


@pytest.mark.usefixtures("trackers_here")
def test_regions_that_cannot_be_found_fail_the_trials_of_their_recording_alone(compare, record, monkeypatch):
    recordings = tuple(str(record(name, 8, {}, wall_m=wall_m)) for name, wall_m in (("good", 3.0), ("bad", 3.2)))
    regions = EvaluationSplit.regions

    def damaged(split, check):
        if split.name == "bad":
            raise RecordingError("bad.mcap: damaged at 3 s")
        return regions(split, check)

    monkeypatch.setattr(EvaluationSplit, "regions", damaged)
    rows = compare("persistence", recordings=recordings).trackers["persistence"].recordings
    assert (rows["good"].outcome, rows["bad"].outcome) == ("ok", "failed")
    assert rows["bad"].reason == "bad.mcap: damaged at 3 s"


@pytest.mark.usefixtures("trackers_here")
def test_a_recording_is_read_as_often_for_three_trackers_as_for_one(compare, record, monkeypatch, tmp_path):
    path, passes, observations = record("hall", 60, {}), [], GridStream.observations
    monkeypatch.setattr(GridStream, "observations", lambda stream: (passes.append(stream), observations(stream))[1])
    counts = []
    for number, trackers in enumerate((["persistence"], ["persistence", "blank", "advection"])):
        compare(*trackers, recordings=(str(path),), out=tmp_path / f"run-{number}")
        counts.append(len(passes))
    assert 0 < counts[0] == counts[1] - counts[0]


def test_an_interrupt_ends_the_search_for_static_cells(shared, settings, record):
    (split,) = resolve(settings("persistence", recordings=(str(record("hall", 40, {})),))).splits
    frames = []

    def stop():
        frames.append(1)
        if len(frames) == 5:
            raise Interrupted

    with pytest.raises(Interrupted):
        shared(1).regions_of(split, stop)
    assert len(frames) == 5
