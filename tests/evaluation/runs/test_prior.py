"""The prior: the expectation of a tracker with weights for a place before its first frame, beside the recording."""

import numpy as np
import polars as pl
import pytest

from gridtrack.evaluation.runs.prior import PRIOR_FILE
from gridtrack.evaluation.runs.trial_record import read_trial_record
from gridtrack.recordings import open_recording
from gridtrack.recordings.stream import GridStream

from scenes.room import trial_of

pytestmark = pytest.mark.usefixtures("trackers_here")


@pytest.fixture
def out(compare, record, train, tmp_path):
    """`out(*recordings, **settings)` runs `static-map`, trained in the room, and `persistence`; the run's folder."""
    before = record("before", stretches={"train": (0.0, 15.0), "validation": (15.0, None)})
    train("weights", "static-map", before, from_scratch=True)

    def out(*recordings, **more):
        given = {"recordings": tuple(map(str, recordings)), "weights": tmp_path / "weights"}
        compare("static-map", "persistence", **(given | more))
        return tmp_path / "run"

    return out


def prior_of(folder):
    table = pl.read_parquet(folder / PRIOR_FILE)
    return {name: table[name].to_numpy().reshape(40, 40) for name in ("visible", "occupied", "probability")}


def test_a_tracker_with_a_map_expects_the_wall_before_it_sees_anything(out, record):
    # the other place has no wall where the room has one: the prior must not come from the frames of the test
    other = record("other", stretches={}, wall_m=5.0)
    prior = prior_of(out(other) / "static-map@other")
    stream = GridStream(open_recording(record("again", stretches={})))
    wall = np.mean([frame.occupied for frame in stream], axis=0) > 0.9
    assert wall.sum() > 20
    assert prior["probability"][wall].mean() > 0.8
    shown = GridStream(open_recording(other))
    for name in ("visible", "occupied"):
        assert (prior[name] == np.sum([getattr(frame, name) for frame in shown], axis=0)).all()
    assert (prior["occupied"][wall] < 0.1 * prior["visible"][wall]).all()


def test_a_row_with_weights_has_a_prior_where_the_sensor_rests(out, record):
    run = out(record("one", stretches={}), record("ride", stretches={}, speed=0.5))
    measured = [path.parent.name for path in run.glob(f"*/{PRIOR_FILE}")]
    assert measured == ["static-map@one"]
    found = read_trial_record(run / "static-map@one")
    assert PRIOR_FILE in found.files
    assert found.times.frames == found.frames_delivered, "the question before the first frame is not timed"


def test_general_weights_expect_the_same_everywhere_and_have_no_prior(compare, record, train, tmp_path):
    validation = (str(record("between", stretches={}, wall_m=4.0)),)
    train("general", "static-map", record("before", stretches={}), validation=validation, general=True)
    recordings = (str(record("one", stretches={}, wall_m=2.0)),)
    summary = compare("static-map", recordings=recordings, weights=tmp_path / "general")
    assert trial_of(summary, "static-map", "one").outcome == "ok"
    assert not list((tmp_path / "run").glob(f"*/{PRIOR_FILE}"))
