"""The moments that come onto the page first: worst, most different, and a spread of ordinary ones."""

import numpy as np
import pytest

from gridtrack.evaluation.runs.sums import SUMS_FILE
from gridtrack.reports.moments import FrameScore, frame_scores, moments_in_order
from gridtrack.reports.run import ReportError


def perfect(occupied):
    return {stamp: FrameScore(tp=n, fp=0, fn=0) for stamp, n in occupied.items()}


def scored():
    scores = {name: perfect(dict.fromkeys(range(9), 4)) for name in ("a", "b", "floor")}
    scores["a"][2] = scores["b"][2] = FrameScore(tp=0, fp=3, fn=4)
    scores["b"][5] = FrameScore(tp=1, fp=3, fn=3)
    scores["floor"][7] = FrameScore(tp=0, fp=4, fn=4)
    return scores


def test_the_worst_the_most_different_and_an_ordinary_moment_come_first():
    order = moments_in_order(scored(), ["a", "b"])
    assert [(one.stamp_ns, one.reason) for one in order[:4]] == [
        (2, "worst"),
        (5, "different"),
        (0, "ordinary"),
        (1, "worst"),
    ]
    assert sorted(one.stamp_ns for one in order) == list(range(9)), "each comes once"


def test_ordinary_moments_are_spread_over_the_time():
    order = moments_in_order({"a": perfect(dict.fromkeys(range(9), 0))}, ["a"])
    assert {one.reason for one in order} == {"ordinary"}
    assert [one.stamp_ns for one in order[:5]] == [0, 8, 4, 2, 6]


def test_a_moment_in_which_nothing_is_occupied_is_neither_worst_nor_different():
    scores = {"a": perfect({0: 1, 1: 0}), "b": perfect({0: 1}) | {1: FrameScore(tp=0, fp=5, fn=0)}}
    assert {one.stamp_ns: one.reason for one in moments_in_order(scores, ["a", "b"])} == {0: "worst", 1: "ordinary"}


def test_moments_of_few_cells_come_last():
    scores = {name: perfect({0: 1, 1: 9, 2: 9}) for name in ("a", "b")}
    scores["b"] |= {0: FrameScore(tp=0, fp=0, fn=1), 2: FrameScore(tp=5, fp=0, fn=4)}
    order = moments_in_order(scores, ["a", "b"])
    assert [(one.stamp_ns, one.reason) for one in order[:2]] == [(2, "worst"), (0, "different")]
    scores |= {name: own | {3: FrameScore(9, 0, 0), 4: FrameScore(8, 0, 1)} for name, own in scores.items()}
    scores["b"][3] = FrameScore(tp=6, fp=0, fn=3)
    order = moments_in_order(scores, ["a", "b"])
    assert [(one.stamp_ns, one.reason) for one in order[:2]] == [(2, "worst"), (3, "different")]


def test_only_moments_that_every_trial_has_are_chosen():
    order = moments_in_order({"a": perfect({0: 1, 1: 9, 2: 1}), "b": perfect({0: 1, 2: 2})}, ["a", "b"])
    assert {one.stamp_ns for one in order} == {0, 2}
    assert moments_in_order({"a": perfect({0: 1}), "b": {}}, ["a", "b"]) == ()
    assert moments_in_order({}, []) == ()


def test_counts_equal_the_stored_ones_at_the_steps(run_folder):
    moments = frame_scores(run_folder / "blank@crossing", [4, 8])
    assert set(moments) == {4, 8}
    assert len(moments[8]) == 20
    assert all(moment.tp == moment.fp == 0 and moment.occupied <= 4 for moment in moments[8].values())
    assert max(moment.occupied for moment in moments[8].values()) == 4, "the block, when it does not turn"
    assert np.array_equal(sorted(moments[8]), list(moments[8]))


def test_scores_that_cannot_be_read_are_an_error_of_one_line(tmp_path):
    (tmp_path / SUMS_FILE).write_bytes(b"not parquet")
    with pytest.raises(ReportError, match="cannot be read as sums") as refused:
        frame_scores(tmp_path, [8])
    assert "\n" not in str(refused.value)
