"""The optional parts of forecasts, velocities and sampled futures, in a run: their scores are in the summary."""

import pytest

from gridtrack.evaluation.runs.sums import TrialSums
from gridtrack.evaluation.scores.energy import ENERGY_STRATA
from gridtrack.evaluation.scores.flow_error import FLOW_STRATA

from scenes import truth_scene
from scenes.room import curve

pytestmark = pytest.mark.usefixtures("trackers_here")

STEPS = 10
CYCLIST_MPS, PEDESTRIAN_MPS = 4 * 2.8 / 5.0, 4 * 3.4 / 8.0


@pytest.fixture
def results(movers, compare, tmp_path):
    """`results(*trackers, **recording)` compares trackers on the scene; their results by label."""

    def results(*trackers, **recording):
        path = truth_scene.write_recording(tmp_path / "room.mcap", seconds=14, **recording)
        summary = compare(*trackers, recordings=(str(path),))
        for label, row in summary.trackers.items():
            trial = row.recordings["room"]
            assert trial.outcome == ("invalid-output" if label == "sometimes" else "ok")
            reason = "unlike in the first one: a tracker gives futures in all of its forecasts or in none"
            assert (reason in trial.reason) == (label == "sometimes")
        return {label: row.recordings["room"] for label, row in summary.trackers.items()}

    return results


def test_true_velocities_have_no_error_and_no_motion_has_the_true_speed(results, tmp_path):
    found = results(
        "right=mover", "still=mover:scale=0", "now=mover:gives=now", "cyclist=mover:gives=cyclist",
        "late=mover:gives=late", "none=mover:gives=nothing", "persistence",
    )  # fmt: skip
    for stratum in FLOW_STRATA:
        error, speed, coverage = (
            {label: curve(found[label], stratum, f"flow_error.{output}") for label in found}
            for output in ("mean", "true_speed", "coverage")
        )
        assert error["right"] == pytest.approx((0.0,) * (STEPS + 1), abs=1e-4)
        assert coverage["right"] == coverage["still"] == (1.0,) * (STEPS + 1)
        assert error["still"] == speed["right"]
        assert all(PEDESTRIAN_MPS - 0.2 < mps < CYCLIST_MPS + 1e-4 for mps in speed["right"])
        assert error["now"] == pytest.approx((0.0, *[None] * STEPS), abs=1e-4)
        assert coverage["now"] == (1.0, *[0.0] * STEPS)
        assert {error[label] for label in ("persistence", "oracle", "none")} == {None}, "forecasts without velocities"
    assert curve(found["cyclist"], "occluded", "flow_error.mean") == pytest.approx((0.0,) * (STEPS + 1), abs=1e-4)
    covered = curve(found["cyclist"], "occluded", "flow_error.coverage")
    assert all(0.1 < share < 0.9 for share in covered), "the pedestrian has no velocity"
    late = curve(found["late"], "dynamic", "flow_error.coverage")
    assert late == (1.0,) * (STEPS + 1), "counted from its first velocity on"
    assert curve(found["right"], "visible", "flow_error.mean") is None
    assert "flow_error" in TrialSums(tmp_path / "run" / "right@room").scores
    assert "flow_error" not in TrialSums(tmp_path / "run" / "persistence@room").scores


def test_sampled_futures_have_an_energy_score_with_and_without_ground_truth(results, tmp_path):
    trackers = "alike=guesser", "mixed=guesser:gives=mixed", "sometimes=guesser:gives=sometimes", "persistence"
    found = results(*trackers, "mover", with_truth=False)
    assert curve(found["mover"], "dynamic", "flow_error.mean") is None, "velocities are scored with ground truth only"
    assert "flow_error" not in TrialSums(tmp_path / "run" / "mover@room").scores
    for stratum in ENERGY_STRATA:
        assert curve(found["alike"], stratum, "energy.score")[0] == 0.0, "step 0 has been seen"
        assert curve(found["alike"], stratum, "energy.spread") == (0.0,) * (STEPS + 1)
        assert min(curve(found["mixed"], stratum, "energy.spread")) > 0.0
        assert curve(found["persistence"], stratum, "energy.score") is None, "its forecasts have no futures"
    mixed, alike = (curve(found[label], "dynamic", "energy.score") for label in ("mixed", "alike"))
    assert mixed[STEPS] < alike[STEPS]
    assert curve(found["alike"], "static", "energy.score") is None
    assert "energy" in TrialSums(tmp_path / "run" / "alike@room").scores
    assert "energy" not in TrialSums(tmp_path / "run" / "persistence@room").scores
