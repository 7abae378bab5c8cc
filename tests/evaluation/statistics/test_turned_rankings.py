"""A ranking that depends on the threshold is said in the summary."""

from __future__ import annotations

import pytest

from gridtrack.evaluation.runs.summary import TrackerSummary
from gridtrack.evaluation.runs.summary import StratumScores, TrialSummary
from gridtrack.evaluation.statistics.turned_rankings import turned_rankings

from scenes import synthetic_run as synthetic

STEPS = synthetic.STEPS + 1
RECORDINGS = {"crossing": synthetic.description()}


def row(f1, at_half, outcome="ok", tracker="tracker", stratum="dynamic"):
    """A tracker with these scores at every step."""
    nothing = dict.fromkeys(("precision", "recall", "pr_auc", "brier", "nll", "ece", "threshold"), (0.5,) * STEPS)
    scores = StratumScores(f1=(f1,) * STEPS, f1_at_half=(at_half,) * STEPS, f1_at_visible=(f1,) * STEPS, **nothing)
    trial = TrialSummary(outcome=outcome, frames_scored=9, frames_expected=9, strata={stratum: scores})
    return TrackerSummary(tracker=tracker, recordings={"crossing": trial})


def test_the_two_rows_the_stratum_the_horizon_and_all_four_scores_are_named():
    rows = {"kalman": row(0.100, 0.189), "persistence": row(0.153, 0.150)}
    (line,) = turned_rankings(RECORDINGS, rows, ())
    assert line == (
        "crossing: the order of trackers depends on the threshold: on dynamic cells 0.5 s ahead persistence is above"
        " kalman at the chosen thresholds (F1 0.153 and 0.100) and below it at a threshold of 0.5 (0.150 and 0.189);"
        " 2 more such pairs of rows and horizons"
    )


def test_one_more_pair_is_singular_and_the_horizon_is_that_of_the_step():
    """A period of 80 ms has no step at 1 s: the tables say 0.96 s, and so does the notice."""
    described = {"crossing": synthetic.description(period_s=0.08, steps=STEPS - 1)}
    (line,) = turned_rankings(described, {"a": row(0.2, 0.1), "b": row(0.1, 0.2)}, ())
    assert "on dynamic cells 0.48 s ahead a is above b at" in line
    assert line.endswith("; 1 more such pair of rows and horizon")


@pytest.mark.parametrize(
    "rows",
    [
        {"a": row(0.6, 0.5), "b": row(0.5, 0.4)},
        {"a": row(0.6, 0.5), "b": row(0.6, 0.7)},
        {"a": row(0.6, 0.5), "b": row(0.5996, 0.7)},
        {"a": row(0.6, 0.5), "b": row(0.5, 0.7, outcome="crashed")},
        {"a": row(0.6, 0.5), "oracle": row(0.5, 0.7, tracker="oracle")},
        {"a": row(0.6, 0.5), "b": row(None, 0.7)},
        {"a": row(0.6, 0.5, stratum="static"), "b": row(0.5, 0.7, stratum="static")},
    ],
    ids=["same order", "equal", "nearly equal", "partial", "ceiling", "undefined", "another stratum"],
)
def test_nothing_is_said_where_the_order_stays(rows):
    assert turned_rankings(RECORDINGS, rows, ()) == []


def test_the_pair_with_the_largest_lead_at_both_thresholds_is_named():
    rows = {"a": row(0.62, 0.50), "b": row(0.60, 0.51), "c": row(0.50, 0.60)}
    (line,) = turned_rankings(RECORDINGS, rows, ())
    assert "a is above c" in line
