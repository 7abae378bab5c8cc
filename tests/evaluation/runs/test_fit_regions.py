"""The score of a training is the referee's: static cells and parts of dynamic cells, on every part of a stretch."""

from __future__ import annotations

import numpy as np
import pytest

from gridtrack.common.errors import RecordingError
from gridtrack.common.geometry import SE2
from gridtrack.evaluation.referee.kinds import regions_of
from gridtrack.evaluation.referee.strata import CELL_KINDS, STRATA
from gridtrack.evaluation.runs.fit_regions import (
    FitScores,
    StretchRegions,
    cell_kinds_for,
    score_in_process,
    store_regions,
)
from gridtrack.evaluation.runs.stretch_files import StoredStretch, store_stretch
from gridtrack.recordings.stream import open_stream
from gridtrack.trackers.baselines import PersistenceTracker
from gridtrack.trackers.contract import stream_of
from gridtrack.trackers.training.excerpts import CachedSource

from scenes import drive, truth_scene

STEPS = 5


def stored(stream, path, *others):
    """The stretch as `fit` receives it, and the score that it receives."""
    source = StoredStretch(store_stretch(stream, path))
    regions = store_regions(stream, cell_kinds_for(stream, [stream, *others]), path.with_suffix(".npz"))
    return source, FitScores([source], lambda n: regions).score


def persistence(source):
    return PersistenceTracker(stream_of(source), PersistenceTracker.Options())


def of_the_referee(stream):
    return score_in_process(persistence(stream), stream, STEPS, regions_of(stream, STRATA))


@pytest.fixture
def with_truth(tmp_path):
    path = tmp_path / "room.mcap"
    truth_scene.write_recording(path, seconds=12)
    return path


def test_the_score_of_a_fit_equals_the_referees_on_the_same_stretch(with_truth, tmp_path):
    stream = open_stream(f"{with_truth}@2s-9s")
    source, score = stored(stream, tmp_path / "0.frames")
    found, expected = score(persistence(source), source, STEPS), of_the_referee(stream)
    assert not np.isnan(expected.f1["in-motion"]).any()
    for name in STRATA:
        assert np.array_equal(found.f1[name], expected.f1[name], equal_nan=True)
        assert np.array_equal(found.log_loss[name], expected.log_loss[name], equal_nan=True)
    assert 0.0 < found.contacts_foreseen[STEPS] < 1.0, "without truth: `fit` counts contacts in visible cells"


def test_an_object_that_stands_for_most_of_an_excerpt_is_not_static_there(with_truth, tmp_path, monkeypatch):
    monkeypatch.setattr(truth_scene, "to_and_fro", lambda time_s, period_s, reach_m: 0.0 if time_s < 6 else reach_m)
    path = tmp_path / "waits.mcap"
    truth_scene.write_recording(path, seconds=12)
    source, score = stored(open_stream(path), tmp_path / "0.frames")
    excerpt = CachedSource.excerpt(source, 0, round(5.0 / source.period_s))
    found = score(persistence(excerpt), excerpt, STEPS)
    assert found.f1["standing"][0] == 1.0, "the rider waits in all of it, and is no wall"
    assert np.isnan(found.f1["in-motion"][0])


def test_without_truth_static_cells_are_found_in_the_stretches_of_the_training_only(tmp_path):
    path = tmp_path / "room.mcap"
    truth_scene.write_recording(path, seconds=12, with_truth=False)
    train, validation = open_stream(f"{path}@0s-6s"), open_stream(f"{path}@6s-9s")
    kinds = cell_kinds_for(train, [train, validation]).at(SE2(), 0)
    assert np.array_equal(kinds, cell_kinds_for(validation, [train, validation]).at(SE2(), 0))
    assert np.array_equal(kinds, cell_kinds_for(train, [open_stream(f"{path}@0s-9s")]).at(SE2(), 0))
    assert (kinds == CELL_KINDS.index("static")).any()


def test_kinds_of_a_moving_sensor_are_kept_by_the_time_and_overlapping_stretches_count_each_frame_once(tmp_path):
    path = drive.write_recording(tmp_path / "d.mcap", 80, with_truth=False)
    whole = open_stream(path)
    expected = cell_kinds_for(whole, [whole])
    parts = [open_stream(f"{path}@{range_}") for range_ in ("4s-", "0s-6s")]
    kept = StretchRegions.read(store_regions(whole, cell_kinds_for(whole, parts), tmp_path / "0.npz")).kinds
    for observation in whole.observations():
        of_frame = observation.reference_T_grid, observation.frame.stamp_ns
        assert np.array_equal(kept.at(*of_frame), expected.at(*of_frame))
    with pytest.raises(KeyError):
        kept.at(SE2(), 10**15)


def test_frames_that_are_of_no_stretch_of_the_training_are_not_scored(with_truth, tmp_path):
    _, score = stored(open_stream(f"{with_truth}@2s-6s"), tmp_path / "0.frames")
    other = open_stream(f"{with_truth}@7s-")
    with pytest.raises(RecordingError, match="can't be scored: it is not part of a stretch that fit received"):
        score(persistence(other), other, STEPS)


@pytest.mark.parametrize(("with_truth", "poses"), [(True, (0.0, 0.0)), (True, (0.05, 0.01)), (False, (0.0, 0.0))])
def test_the_score_of_a_fit_equals_the_referees_if_the_sensor_moves(tmp_path, with_truth, poses):
    path = drive.write_recording(tmp_path / "d.mcap", 16, with_truth=with_truth, pose_noise=poses)
    stream = open_stream(path)
    source, score = stored(stream, tmp_path / "0.frames")
    found, expected = score(persistence(source), source, STEPS), of_the_referee(stream)
    for name in ("visible", "static", "dynamic"):
        assert found.f1[name] == pytest.approx(expected.f1[name], abs=2e-3), "equal but for rounding"
    assert found.f1["in-motion"] == pytest.approx(expected.f1["in-motion"], abs=0.1)
    if not with_truth:
        assert found.contacts_foreseen[STEPS] == pytest.approx(expected.contacts_foreseen[STEPS], abs=0.02)


def test_a_fit_of_a_tracker_that_cannot_follow_the_sensor_is_refused(tmp_path):
    stream = open_stream(drive.write_recording(tmp_path / "d.mcap", 4))
    source, score = stored(stream, tmp_path / "0.frames")

    class AtRest(PersistenceTracker):
        moving_sensor = False

    with pytest.raises(RecordingError, match="the sensor moves, and AtRest follows only a sensor at rest"):
        score(AtRest(stream_of(source), AtRest.Options()), source, STEPS)
