"""Scores of later passes that are too good for a tracker without a memory."""

from __future__ import annotations

import pytest

from gridtrack.evaluation.runs.later_passes import remembered
from gridtrack.evaluation.runs.passes import AtStrength, Robustness
from gridtrack.evaluation.runs.summary import Estimate, TrackerSummary, TrialSummary
from gridtrack.recordings.degradation import Degradation


def trackers(later: float, high: float | None):
    """A tracker with F1 0.5 on dynamic cells in the first pass, and `later` with half of the beams."""
    first = Estimate(value=(0.5,), low=(0.4,), high=(high,)) if high else Estimate(value=(0.5,))
    points = tuple(
        AtStrength(strength=strength, value=strength / 2, delivered="", f1={"dynamic": (f1,)})
        for strength, f1 in ((0.0, 0.5), (1.0, later))
    )
    robustness = Robustness(degradation=Degradation(beam_dropout=0.5), kinds={"beam_dropout": points})
    trial = TrialSummary(outcome="ok", strata={"dynamic": {"f1": {"f1": first}}}, robustness=robustness)
    return {"mine": TrackerSummary(tracker="mine", role="tracker", options={}, recordings={"hall": trial})}


@pytest.mark.parametrize(("later", "high"), [(0.95, 0.6), (0.61, 0.6), (0.61, None)])
def test_a_later_pass_above_chance_is_a_notice_with_the_remedy(later, high):
    (notice,) = remembered(trackers(later, high))
    assert notice == (
        f"mine on hall: F1 is 0.500 in the first pass and {later:.3f} in a later one (beam_dropout 0.5, dynamic cells,"
        " step 0), which is more than chance: the tracker may remember the recording; --sandbox prevents it"
    )


@pytest.mark.parametrize(("later", "high"), [(0.3, 0.6), (0.6, 0.6), (0.59, None)])
def test_a_later_pass_within_chance_is_none(later, high):
    assert list(remembered(trackers(later, high))) == []
