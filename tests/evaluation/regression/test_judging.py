"""Judging single recordings, from rows that are made by hand."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from gridtrack.evaluation.regression.judging import judged_recordings, judged_row
from gridtrack.evaluation.regression.rows import PairedRow, row_tests
from gridtrack.evaluation.regression.settings import GateSettings
from gridtrack.evaluation.scores.definition import TrialFacts
from gridtrack.evaluation.scores.f1 import F1
from gridtrack.evaluation.scores.thresholds import half

UNITS = 20


def fallen_row(recalls, now, recordings):
    """F1 of trainings with these recalls and a run with the recall `now`, alike in all units but for a little noise."""
    rng = np.random.default_rng(0)
    tp = 1000 * (np.array([*recalls, now])[:, None] + 0.002 * rng.standard_normal((len(recalls) + 1, UNITS)))
    parts = F1.parts(TrialFacts(0.2, 1, ("visible",), half(1, ("visible",))))
    sums = np.stack([tp, 0 * tp, 1000 - tp, *13 * [0 * tp]], axis=-1)
    return PairedRow(
        "net", F1, F1.output("f1"), "visible", "middle", parts, sums[:-1], sums[-1], np.arange(UNITS), recordings
    )


@pytest.mark.parametrize(("recalls", "worse"), [((0.3, 0.6, 0.9), False), ((0.6,), True)])
def test_a_single_recording_is_judged_over_all_units_with_the_test_over_trainings_and_has_no_list(recalls, worse):
    row = fallen_row(recalls, 0.4, ("one",) * UNITS)
    (test,) = row_tests([row])
    found = judged_row(row, test, GateSettings())
    assert found.fall > 0.1
    assert (found.verdict == "worse") == worse
    assert judged_recordings([row], [test], GateSettings()) == ()


def test_equal_rows_have_p_1_beside_a_fallen_one():
    recordings = ("one",) * UNITS
    equal, fallen = fallen_row((0.6,), 0.6, recordings), fallen_row((0.6,), 0.4, recordings)
    equal = dataclasses.replace(equal, run=equal.trainings[0])
    assert [test.p for test in row_tests([equal])] == [1.0]
    alone, beside = row_tests([fallen])[0].p, row_tests([equal, fallen])[1].p
    assert alone == beside < 0.01


def test_a_collapse_on_either_of_two_recordings_is_listed():
    row = fallen_row((0.3, 0.6, 0.9), 0.4, ("one", "two") * (UNITS // 2))
    found = judged_recordings([row], row_tests([row]), GateSettings())
    assert {(one.recording, one.criterion) for one in found} == {("one", "collapse"), ("two", "collapse")}
