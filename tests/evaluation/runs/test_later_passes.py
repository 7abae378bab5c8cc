"""Scores that are too good for a tracker without a memory of the recording."""

from __future__ import annotations

import shlex
import sys

import pytest

from gridtrack.evaluation.runs.later_passes import with_memories
from gridtrack.evaluation.runs.passes import AtStrength, Robustness
from gridtrack.evaluation.runs.summary import (
    Estimate,
    PairFamily,
    PairTest,
    PointEstimate,
    TrackerSummary,
    TrialSummary,
)
from gridtrack.recordings.degradation import Degradation

from scenes.room import trial_of


def trackers(later: float, high: float | None):
    """A tracker with F1 0.5 on dynamic cells in the first pass, and `later` with half of the beams."""
    first = Estimate(value=(0.5,), low=(0.4,), high=(high,)) if high else Estimate(value=(0.5,))
    points = tuple(
        AtStrength(strength=strength, value=strength / 2, delivered="", scores={"f1": {"dynamic": (f1,)}})
        for strength, f1 in ((0.0, 0.5), (1.0, later))
    )
    robustness = Robustness(degradation=Degradation(beam_dropout=0.5), kinds={"beam_dropout": points})
    trial = TrialSummary(outcome="ok", strata={"dynamic": {"f1": {"f1": first}}}, robustness=robustness)
    return {"mine": TrackerSummary(tracker="mine", role="tracker", options={}, recordings={"hall": trial})}


@pytest.mark.parametrize(("later", "high"), [(0.95, 0.6), (0.61, 0.6), (0.61, None)])
def test_a_later_pass_above_chance_is_a_mark_and_a_notice_with_the_remedy(later, high):
    rows, (notice,) = with_memories(trackers(later, high), (), {"mine"})
    assert str(notice) == (
        f"mine on hall: F1 is 0.500 in the first pass and {later:.3f} in a later one (beam_dropout 0.5, dynamic cells,"
        " step 0), which is more than chance: the tracker may remember the recording; --sandbox prevents it"
    )
    assert rows["mine"].recordings["hall"].memory in notice.text


@pytest.mark.parametrize(("later", "high"), [(0.3, 0.6), (0.6, 0.6), (0.59, None)])
def test_a_later_pass_within_chance_is_none(later, high):
    rows, notices = with_memories(trackers(later, high), (), {"mine"})
    assert (rows["mine"].recordings["hall"].memory, notices) == ("", [])


def test_a_tracker_that_cannot_read_a_file_of_its_own_is_not_marked():
    """It is one of gridtrack, or runs in the sandbox."""
    rows, notices = with_memories(trackers(0.95, 0.6), (), ())
    assert (rows["mine"].recordings["hall"].memory, notices) == ("", [])


@pytest.mark.parametrize(
    ("options", "verdict", "marked"),
    [({}, "better", "second"), ({}, "worse", "first"), ({}, "no difference shown", None), ({"a": 1}, "better", None)],
)
def test_of_two_rows_of_one_tracker_the_better_one_is_marked(options, verdict, marked):
    """Rows with other options may differ."""
    rows = {
        label: TrackerSummary(tracker="mine", options=own, recordings={"hall": TrialSummary(outcome="ok")})
        for label, own in (("first", {}), ("second", options))
    }
    pair = PairTest(tracker="second", other="first", difference=PointEstimate(value=0.4), verdict=verdict)
    place = {"score": "f1", "output": "f1", "stratum": "dynamic", "horizon_s": 1.0, "step": 8}
    families = [PairFamily(recordings="hall", units=20, pairs=(pair,), **place)]
    found, notices = with_memories(rows, families, rows)
    assert [label for label, row in found.items() if row.recordings["hall"].memory] == [marked] * bool(marked)
    assert len(notices) == bool(marked)
    assert all(
        "better by 0.400 (f1, dynamic cells, 1 s ahead), which is more than chance" in one.text for one in notices
    )


@pytest.mark.usefixtures("trackers_here")
def test_a_trial_that_an_earlier_start_did_not_end_is_marked(compare, tmp_path):
    """The frames that it received then may be in a file of it; those of gridtrack keep none."""
    serve = (sys.executable, "-P", "-m", "gridtrack.trackers.serve", "persistence")
    program = tmp_path / "program"
    program.write_text(
        f"#!/bin/sh\n[ -e {tmp_path}/seen ] || {{ touch {tmp_path}/seen; exit 1; }}\n{shlex.join(serve)}\n"
    )
    program.chmod(0o755)
    toml = tmp_path / "trackers.toml"
    toml.write_text(f"[mine]\ncommand = '{program}'\n")
    assert trial_of(compare("mine", "blank", trackers_toml=toml), "mine").outcome == "crashed"
    sign = "the tracker was started before, in a trial that did not end"
    for _ in range(2):  # the mark stays
        summary = compare("mine", "blank", trackers_toml=toml, resume=True)
        assert (trial_of(summary, "mine").memory, trial_of(summary, "blank").memory) == (sign, "")
        assert [one for one in map(str, summary.notices) if sign in one and one.startswith("mine on room: ")] != []
