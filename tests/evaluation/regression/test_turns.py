"""`gridtrack regress --speed-base`: a tracker of the run and its base, timed in turns."""

from __future__ import annotations

import json
import math
import sys

import numpy as np
import pytest

from gridtrack.evaluation.hosting.tracker_process import TrackerProcess
from gridtrack.evaluation.regression import turns
from gridtrack.evaluation.regression.speed import TurnsRow
from gridtrack.evaluation.regression.turns import speed_ratio_interval


@pytest.fixture
def compared(staged, record, compare, regress, tmp_path, monkeypatch, trackers_here):
    """A run of `staged`, its baseline, and a trackers.toml that names another environment of it, `old`."""
    out, baseline = tmp_path / "now", tmp_path / "baseline.json"
    compare("staged", "blank", recordings=(str(record("one", seconds=8, stretches={})),), every_s=None, out=out)
    assert regress(out, "--baseline", baseline, "--update").code == 0
    (tmp_path / "base.toml").write_text(f'[old]\npython = "{sys.executable}"\ntracker = "staged"\n')
    monkeypatch.setattr(turns, "TURN_ROUNDS", 2)
    return out, baseline


@pytest.fixture
def asked(compared, tmp_path):
    """The arguments of the check."""
    out, baseline = compared
    return [out, "--baseline", baseline, "--speed-base", "staged=old", "--trackers-toml", tmp_path / "base.toml"]


def times(monkeypatch, **ms: float) -> list[str]:
    """Let the calls of each tracker take `ms`; the returned list gets the names in the order of the calls."""
    calls: list[str] = []

    def last_ms(process: TrackerProcess) -> float:
        calls.append(process.launch.name)
        return ms[process.launch.name]

    monkeypatch.setattr(TrackerProcess, "last_ms", property(last_ms))
    return calls


def test_a_tracker_that_takes_longer_than_its_base_is_worse_and_both_get_each_frame_in_turns(
    asked, regress, monkeypatch
):
    calls = times(monkeypatch, staged=3.0, old=2.0)
    done = regress(*asked, "--json")
    verdict = json.loads(done.out)
    assert (done.code, verdict["verdict"]) == (1, "worse")
    assert [(row["label"], row["call"], row["base"], row["standing"]) for row in verdict["turns"]] == [
        ("staged", "update", "old", "worse"),
        ("staged", "predict", "old", "worse"),
    ]
    assert [row["ratio"] for row in verdict["turns"]] == pytest.approx([1.5, 1.5])
    assert calls.count("staged") == calls.count("old")
    # two frames have six calls: both trackers update and forecast on the first, and update on the second
    rounds = np.array(calls).reshape(2, -1, 6)
    firsts, seconds = rounds[:, :, 0], rounds[:, :, 4]
    assert (rounds[:, :, 1] == firsts).all(), "the tracker that is updated first forecasts first"
    assert (firsts[:, 1:] != firsts[:, :-1]).all(), "and not twice in turn: each is first for half of the forecasts"
    assert (seconds == firsts).all(), "the second frame has the order of the first"
    assert (firsts[0] != firsts[1]).all()
    assert regress(*asked, "--speed-margin", "0.6").code == 0


def test_a_tracker_that_takes_as_long_passes_and_its_ratio_is_printed(asked, regress, monkeypatch, tmp_path):
    times(monkeypatch, staged=2.1, old=2.0)
    page, junit = tmp_path / "page.md", tmp_path / "junit.xml"
    done = regress(*asked, "--markdown", page, "--junit", junit)
    assert done.code == 0
    assert (
        "timed in turns: staged: update takes 1.050 times as long as old's, in turns, 95 % interval [1.050, 1.050]"
        in done.out
    )
    assert "| no worse | staged | update | old | 1.050 |" in page.read_text()
    assert "speed of update in turns with old" in junit.read_text()


def test_a_failed_timing_is_not_measured_and_wrong_use_is_refused(asked, compared, staged, regress):
    out, baseline = compared
    assert (regress(*asked[:-2]).code, "no tracker 'old'" in regress(*asked[:-2]).err) == (2, True)
    wrong = regress(out, "--baseline", baseline, "--speed-base", "staged")
    assert (wrong.code, "expected LABEL=NAME" in wrong.err) == (2, True)
    wrong = regress(out, "--baseline", baseline, "--speed-base", "staged2=blank")
    assert (wrong.code, "the run has no tracker 'staged2'; did you mean 'staged'?" in wrong.err) == (2, True)
    module = staged / "staged_tracker.py"
    module.write_text(module.read_text() + "# edited\n")
    edited = regress(*asked)
    assert (edited.code, "staged: the tracker's code was edited since the run" in edited.err) == (3, True)
    module.write_text("raise RuntimeError('broken')\n")
    assert regress(*asked).code == 3


def test_the_interval_is_students_t_over_rounds_of_the_logarithm() -> None:
    ratio, low, high = speed_ratio_interval([math.log(1.0), math.log(1.1), math.log(1.21)])
    assert ratio == pytest.approx(1.1)
    half = 4.302652729911275 * math.log(1.1) / math.sqrt(3)  # t of 0.975 with two degrees of freedom
    assert (low, high) == pytest.approx((1.1 * math.exp(-half), 1.1 * math.exp(half)))


@pytest.mark.parametrize(("low", "verdict"), [(1.09, "no worse"), (1.11, "worse")])
def test_a_ratio_is_worse_if_the_whole_interval_is_beyond_the_margin(low: float, verdict: str) -> None:
    assert TurnsRow("staged", "update", "old", 1.2, low, 1.3, 8, margin=0.1).verdict == verdict
