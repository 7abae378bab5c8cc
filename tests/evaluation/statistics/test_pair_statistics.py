"""All pairs of rows: who is told apart from whom, with one correction over all of them."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from gridtrack.evaluation.statistics.jackknife import PairedDifferences, holm
from gridtrack.evaluation.statistics.pair_statistics import PAIR_SCORES, pair_test
from gridtrack.evaluation.statistics.summary import summarise

from scenes import synthetic_run as synthetic

RECORDINGS = [f"seed-{i:02}" for i in range(20)]
SKILLS = {"persistence": 0.6, "good": 0.8, "twin": 0.6, "unlucky": 0.9, "oracle": 1.0}


def run_of(folder, skills, recordings=RECORDINGS, **write):
    return [
        synthetic.write_trial(
            folder, label, name, skill, seed=i, frames=6, scored=3 if label == "unlucky" and i == 0 else None, **write
        )
        for i, name in enumerate(recordings)
        for label, skill in skills.items()
    ]


def summary_of(trials, recordings=RECORDINGS):
    return summarise({name: synthetic.description() for name in recordings}, trials, [], False)


@pytest.fixture(scope="module")
def twenty(tmp_path_factory):
    return summary_of(run_of(tmp_path_factory.mktemp("pairs"), SKILLS))


def family(summary, score="f1", stratum="in-motion", horizon_s=1.0):
    (found,) = [one for one in summary.pairs if (one.score, one.stratum, one.horizon_s) == (score, stratum, horizon_s)]
    return found


def test_every_pair_of_complete_rows_is_tested_once_and_no_other(twenty):
    for one in twenty.pairs:
        assert [(t.tracker, t.other) for t in one.pairs] == list(combinations(["persistence", "good", "twin"], 2))
        assert (one.recordings, one.units) == ("all recordings", 20)
    assert {one.score for one in twenty.pairs} == set(PAIR_SCORES)


@pytest.mark.parametrize("score", ["f1", "pr_auc", "nll", "beam_error"])
def test_a_pair_has_the_difference_and_the_p_value_of_the_test_against_the_reference(twenty, score):
    (against,) = [one for one in twenty.differences if one.tracker == "good"]
    (expected,) = [t for t in against.headline if (t.stratum, t.horizon_s) == ("in-motion", 1.0)]
    (found,) = [t for t in family(twenty, score).pairs if t.other == "good"]
    assert found.difference == pytest.approx(-getattr(expected, score), abs=2e-6)
    assert found.low == pytest.approx(-getattr(expected, f"{score}_high"), abs=2e-6)
    assert found.p == pytest.approx(getattr(expected, f"{score}_p"), rel=0.01)


def test_holm_is_over_all_pairs_of_the_score(twenty):
    tests = family(twenty).pairs
    assert [t.p_holm for t in tests] == pytest.approx(holm(np.array([t.p for t in tests])).tolist(), rel=0.01)


def test_better_and_worse_are_said_where_they_are_shown(twenty):
    assert [t.verdict for t in family(twenty).pairs] == ["worse", "no difference shown", "better"]


@pytest.mark.parametrize(("score", "verdict"), [("f1", "better"), ("nll", "worse"), ("beam_error", "worse")])
def test_better_has_the_direction_of_the_score(score, verdict):
    higher = PairedDifferences(*np.array([0.2, 0.1, 0.3, 0.001]))
    assert pair_test("a", "b", higher, 0.01, score).verdict == verdict


def test_of_nineteen_recordings_no_pair_is_tested(tmp_path):
    skills = {"persistence": 0.6, "good": 0.8}
    assert summary_of(run_of(tmp_path, skills, RECORDINGS[1:]), RECORDINGS[1:]).pairs == ()


def test_rows_without_a_frame_in_common_are_not_tested(tmp_path):
    trials = run_of(tmp_path, {"persistence": 0.6}) + run_of(tmp_path, {"good": 0.8}, delivered="f")
    assert summary_of(trials).pairs == ()
