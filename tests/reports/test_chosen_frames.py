"""Frames are chosen by the rule that the page states."""

import numpy as np
import pytest

from gridtrack.evaluation.results.columns import SCORES_TABLE
from gridtrack.reports.chosen_frames import FrameScore, choose_frames, frame_scores
from gridtrack.reports.run import ReportError


def perfect(occupied):
    return {stamp: FrameScore(tp=n, fp=0, fn=0) for stamp, n in occupied.items()}


def test_each_part_gives_its_busiest_frame_the_earliest_of_equals():
    occupied = {0: 3, 1: 9, 2: 9, 10: 1, 11: 2, 20: 5, 21: 4}
    chosen = choose_frames({"a": perfect(occupied)}, ["a"], 3)
    assert [moment.stamp_ns for moment in chosen] == [1, 11, 20]


def test_one_more_is_where_the_trackers_differ_most_the_floor_aside():
    occupied = dict.fromkeys(range(9), 4)
    scored = {name: perfect(occupied) for name in ("a", "b", "floor")}
    scored["b"][5] = FrameScore(tp=1, fp=3, fn=3)
    scored["floor"][7] = FrameScore(tp=0, fp=4, fn=4)
    chosen = choose_frames(scored, ["a", "b"], 3)
    assert [moment.stamp_ns for moment in chosen] == [0, 3, 5, 6]
    assert "largest difference between trackers: 0.75 in F1 on in-motion cells" in chosen[2].reason


def test_where_trackers_agree_no_frame_is_chosen_for_a_difference():
    scored = {name: perfect(dict.fromkeys(range(9), 4)) for name in "ab"}
    assert len(choose_frames(scored, ["a", "b"], 3)) == 3


def test_only_frames_that_every_trial_has_are_chosen():
    chosen = choose_frames({"a": perfect({0: 1, 1: 9, 2: 1}), "b": perfect({0: 1, 2: 2})}, ["a", "b"], 1)
    assert [moment.stamp_ns for moment in chosen] == [2]
    assert choose_frames({"a": perfect({0: 1}), "b": {}}, ["a", "b"], 3) == ()
    assert choose_frames({}, [], 3) == ()


def test_counts_are_those_of_the_store_at_the_step(run_folder):
    moments = frame_scores(run_folder / "blank@crossing" / SCORES_TABLE.file, 8)
    assert len(moments) == 20
    assert all(moment.tp == moment.fp == 0 and moment.occupied <= 4 for moment in moments.values())
    assert max(moment.occupied for moment in moments.values()) == 4, "the block, when it does not turn"
    assert np.array_equal(sorted(moments), list(moments))


def test_scores_that_cannot_be_read_are_an_error_of_one_line(tmp_path):
    (tmp_path / SCORES_TABLE.file).write_bytes(b"not parquet")
    with pytest.raises(ReportError, match="cannot be read as scores") as refused:
        frame_scores(tmp_path / SCORES_TABLE.file, 8)
    assert "\n" not in str(refused.value)
