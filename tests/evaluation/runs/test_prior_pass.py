"""The prior: what a tracker with weights expects of a place that it has not seen, beside what the recording shows."""

import numpy as np
import polars as pl
import pytest

from gridtrack.evaluation.results.columns import PRIOR_TABLE
from gridtrack.evaluation.runs.plan import resolve
from gridtrack.evaluation.runs.recipe import Recipe
from gridtrack.evaluation.runs.runner import run
from gridtrack.evaluation.runs.settings import CompareSettings
from gridtrack.evaluation.runs.train import train_tracker
from gridtrack.evaluation.runs.trial_record import read_trial_record
from gridtrack.recordings import open_recording
from gridtrack.recordings.stream import GridStream

OPTIONS = {"horizon_s": 1.0, "every_s": 0.5, "jobs": 2}


@pytest.fixture
def weights(record, tmp_path, monkeypatch):
    """The folder with `static-map` trained in the room."""
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "home"))
    folder = tmp_path / "weights"
    trained_on = str(record("before", stretches={"train": (0.0, 15.0), "validation": (15.0, None)}))
    recipe = Recipe(tracker="static-map", recordings=(trained_on,), from_scratch=True, out=folder)
    train_tracker(recipe, lambda text: None)
    return folder


@pytest.fixture
def compare(weights, progress, tmp_path):
    """`compare(recordings, **settings)` runs `static-map` and `persistence`; the folder of the run."""

    def compare(*recordings, **more):
        settings = CompareSettings(
            recordings=tuple(map(str, recordings)),
            trackers=("static-map", "persistence"),
            out=tmp_path / "run",
            weights=weights,
            **(OPTIONS | more),
        )
        run(resolve(settings), ("gridtrack", "compare"), progress)
        return settings.out

    return compare


def prior_of(folder):
    table = pl.read_parquet(folder / PRIOR_TABLE.file)
    return {name: table[name].to_numpy().reshape(40, 40) for name in ("visible", "occupied", "probability")}


def test_a_tracker_with_a_map_expects_the_wall_before_it_sees_anything(compare, record):
    # the other place has no wall where the room has one: the prior must not come from the frames of the test
    other = record("other", stretches={}, wall_m=5.0)
    prior = prior_of(compare(other) / "static-map@other")
    stream = GridStream(open_recording(record("again", stretches={})))
    wall = np.mean([frame.occupied for frame in stream], axis=0) > 0.9
    assert wall.sum() > 20
    assert prior["probability"][wall].mean() > 0.8
    shown = GridStream(open_recording(other))
    for name in ("visible", "occupied"):
        assert (prior[name] == np.sum([getattr(frame, name) for frame in shown], axis=0)).all()
    assert (prior["occupied"][wall] < 0.1 * prior["visible"][wall]).all()


def test_one_recording_of_a_place_is_enough_and_a_tracker_without_weights_has_no_prior(compare, record):
    out = compare(record("one", stretches={}), record("two", stretches={}, seconds=15))
    found = sorted(path.parent.name for path in out.glob(f"*/{PRIOR_TABLE.file}"))
    assert found == ["static-map@one"]
    assert PRIOR_TABLE.file in read_trial_record(out / "static-map@one").files


def test_a_sensor_that_moves_shows_no_place_for_which_there_could_be_a_prior(compare, record):
    out = compare(record("ride", stretches={}, speed=0.5))
    assert not list(out.glob(f"*/{PRIOR_TABLE.file}"))


def test_general_weights_expect_the_same_everywhere_and_have_no_prior(record, tmp_path, progress):
    trained_on = (str(record("before", stretches={})),)
    validation = (str(record("between", stretches={}, wall_m=4.0)),)
    recipe = Recipe(
        tracker="static-map", recordings=trained_on, validation=validation, general=True, out=tmp_path / "general"
    )
    train_tracker(recipe, lambda text: None)
    recordings = (str(record("one", stretches={}, wall_m=2.0)),)
    settings = CompareSettings(
        recordings=recordings, trackers=("static-map",), out=tmp_path / "run", weights=tmp_path / "general", **OPTIONS
    )
    summary = run(resolve(settings), ("gridtrack", "compare"), progress)
    assert summary.trackers["static-map"].recordings["one"].outcome == "ok"
    assert not list((tmp_path / "run").glob(f"*/{PRIOR_TABLE.file}"))


def test_a_run_of_before_gets_its_priors_when_it_is_resumed(compare, record):
    path = record("one", stretches={})
    out = compare(path)
    record_of_trial = read_trial_record(out / "static-map@one")
    (out / "static-map@one" / PRIOR_TABLE.file).unlink()
    files = {name: sha for name, sha in record_of_trial.files.items() if name != PRIOR_TABLE.file}
    record_of_trial.model_copy(update={"files": files}).write(out / "static-map@one")
    compare(path, resume=True)
    assert prior_of(out / "static-map@one")["probability"].max() > 0.8
