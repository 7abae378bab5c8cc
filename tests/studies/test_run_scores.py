"""What the pages take of a comparison's summary: pooled scores, or those of its only recording."""

from __future__ import annotations

import json

import pytest

from studies.kept_summary import kept
from studies.support.run_scores import RunScores

SCORES = {"strata": {"dynamic": {"f1": [0.1, 0.2], "f1_low": None, "f1_high": None}}}
OTHER = {"strata": {"dynamic": {"f1": [0.3, 0.4], "f1_low": [0.2, 0.3], "f1_high": [0.4, 0.5]}}}


def summary(**rows):
    trackers = {label: {"pooled": pooled, "recordings": recordings} for label, (pooled, recordings) in rows.items()}
    return {
        "recordings": {"hall": {"horizons_s": [0.0, 0.5]}},
        "trackers": trackers,
        "trainings": [{"labels": ["kalman", "again"]}],
        "differences": [{"tracker": label} for label in trackers],
        "pairs": [{"tracker": "kalman"}],
    }


@pytest.fixture
def scores(tmp_path):
    def write(found):
        (tmp_path / "summary.json").write_text(json.dumps(found))
        return RunScores(tmp_path / "summary.json")

    return write


def test_a_run_of_one_recording_has_the_scores_of_that_recording(scores):
    assert scores(summary(kalman=(None, {"hall": SCORES}))).value("kalman", "f1 dynamic 0.5 s") == "0.200"


def test_a_run_of_several_has_the_pooled_ones_with_their_interval(scores):
    found = scores(summary(kalman=(OTHER, {"hall": SCORES})))
    assert found.value("kalman", "f1 dynamic 0.5 s", interval=True) == "0.400 [.300, .500]"


def test_what_is_kept_has_one_training_of_each_tracker_and_no_single_recording_of_several():
    found = kept(summary(kalman=(OTHER, {"hall": SCORES}), again=(OTHER, {}), alone=(None, {"hall": SCORES})))
    assert list(found["trackers"]) == ["kalman", "alone"]
    assert [one["tracker"] for one in found["differences"]] == ["kalman", "alone"]
    assert found["trackers"]["kalman"]["recordings"] == {}
    assert found["trackers"]["alone"]["recordings"] == {"hall": SCORES}
    assert found["pairs"] == []
