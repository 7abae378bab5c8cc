"""A run on a recording that knows what was truly there: what is hidden is scored, there is a ceiling, classes count."""

import importlib.util
from pathlib import Path

import polars as pl
import pytest

from gridtrack.common.errors import ConfigurationError
from gridtrack.evaluation.plan import CompareSettings, resolve
from gridtrack.evaluation.runner import run
from gridtrack.evaluation.scores import SCORES
from gridtrack.evaluation.strata import STRATA, STRATA_WITH_TRUTH

SOURCE = Path(__file__).with_name("truth_scene.py")
spec = importlib.util.spec_from_file_location("truth_scene", SOURCE)
truth_scene = importlib.util.module_from_spec(spec)
spec.loader.exec_module(truth_scene)
HORIZON_S, STEPS = 1.0, 10


@pytest.fixture
def compare(tmp_path, told, install):
    """`compare(*trackers, noise_m=..., with_truth=...)` gives the summary and the run's folder."""
    plugins = Path(__file__).parents[1] / "plugins" / "classifier.py"
    points = {"classifier": "classifier:Classifier", "stranger": "classifier:Stranger"}
    install("classifiers", points, {"classifier.py": plugins.read_text()})

    def compare(*trackers, resume=False, **recording):
        path = truth_scene.write_recording(tmp_path / "room.mcap", **recording)
        settings = CompareSettings(
            recordings=(str(path),),
            trackers=trackers,
            out=tmp_path / "run",
            horizon_s=HORIZON_S,
            every_s=0.5,
            jobs=1,
            resume=resume,
        )
        return run(resolve(settings), (), told), tmp_path / "run"

    return compare


def trial_of(summary, label):
    return summary["trackers"][label]["recordings"]["room"]


def test_with_truth_hidden_cells_are_scored_and_the_oracle_is_the_ceiling(compare):
    summary, folder = compare("persistence", "static-map")
    oracle = trial_of(summary, "oracle")
    assert oracle["outcome"] == "ok"
    assert oracle["frames_scored"] == oracle["frames_expected"] == trial_of(summary, "persistence")["frames_scored"]
    assert tuple(oracle["strata"]) == STRATA_WITH_TRUTH
    for stratum in ("visible", "moving", "static", "occluded", "occluded moving"):
        assert oracle["strata"][stratum]["f1"] == [1.0] * (STEPS + 1), "nothing is noisy in this recording"
    persistence = trial_of(summary, "persistence")["strata"]
    assert persistence["visible"]["f1"][0] == 1.0, "on what is seen, step 0 is copying"
    assert persistence["occluded moving"]["f1"][0] < 0.2, "what is not seen is not where it was last seen"
    assert 0.0 < persistence["moving"]["f1"][STEPS] < 1.0
    assert summary["recordings"]["room"]["parity"] is True
    assert pl.read_parquet(folder / "persistence@room" / SCORES)["stratum"].n_unique() == len(STRATA_WITH_TRUTH)


def test_range_noise_is_what_even_the_oracle_misses(compare):
    summary, _ = compare("blank", noise_m=0.04)
    moving, occluded = (trial_of(summary, "oracle")["strata"][name]["f1"] for name in ("moving", "occluded"))
    assert all(0.5 < f1 < 0.99 for f1 in moving)
    assert occluded == [1.0] * (STEPS + 1)


def test_the_static_cells_are_the_outlines_of_what_stands(compare):
    """A cyclist who waits is no wall, though it is there in every frame: only the scene can tell."""
    summary, _ = compare("persistence")
    recall = trial_of(summary, "persistence")["strata"]["static"]["recall"]
    assert min(recall) > 0.9


def test_a_recording_without_truth_has_no_ceiling_and_the_strata_it_always_had(compare):
    summary, _ = compare("persistence", with_truth=False)
    assert set(summary["trackers"]) == {"persistence"}
    assert tuple(trial_of(summary, "persistence")["strata"]) == STRATA
    assert trial_of(summary, "persistence")["semantics"] is None


def test_a_resumed_run_keeps_its_oracle(compare, told):
    compare("blank")
    told.frames.clear()
    summary, _ = compare("blank", resume=True)
    assert "oracle@room" not in told.frames
    assert trial_of(summary, "oracle")["outcome"] == "ok"


def test_no_tracker_takes_the_oracles_name(compare):
    with pytest.raises(ConfigurationError, match="'oracle' is the referee's own row"):
        compare("Oracle=blank")
