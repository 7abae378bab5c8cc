"""The optional parts of forecasts, velocities and sampled futures, in a run: their scores are in the summary."""

from pathlib import Path

import pytest

from gridtrack.evaluation.results.columns import ENERGY_TABLE, FLOW_TABLE
from gridtrack.evaluation.runs.plan import resolve
from gridtrack.evaluation.runs.runner import run
from gridtrack.evaluation.runs.settings import CompareSettings
from gridtrack.evaluation.scores.energy import ENERGY_STRATA
from gridtrack.evaluation.scores.flow_error import FLOW_STRATA

from scenes import truth_scene

STEPS = 10
CYCLIST_MPS, PEDESTRIAN_MPS = 4 * 2.8 / 5.0, 4 * 3.4 / 8.0


@pytest.fixture
def strata(install, progress, tmp_path):
    """Compares trackers on the scene, and gives their scores by label and stratum."""
    files = {"movers.py": (Path(__file__).parents[2] / "plugins" / "movers.py").read_text()}
    install("movers", {"mover": "movers:Mover", "guesser": "movers:Guesser"}, files)

    def compare(*trackers, **recording):
        path = truth_scene.write_recording(tmp_path / "room.mcap", seconds=14, **recording)
        settings = CompareSettings(
            recordings=(str(path),), trackers=trackers, out=tmp_path / "run", horizon_s=1.0, every_s=0.5, jobs=1
        )
        summary = run(resolve(settings), (), progress)
        for label, row in summary.trackers.items():
            trial = row.recordings["room"]
            assert trial.outcome == ("invalid-output" if label == "sometimes" else "ok")
            reason = "unlike in the first one: a tracker gives futures in all of its forecasts or in none"
            assert (reason in trial.reason) == (label == "sometimes")
        return {label: row.recordings["room"].strata for label, row in summary.trackers.items()}

    return compare


def test_true_velocities_have_no_error_and_no_motion_has_the_true_speed(strata, tmp_path):
    found = strata(
        "right=mover", "still=mover:scale=0", "now=mover:gives=now", "cyclist=mover:gives=cyclist",
        "late=mover:gives=late", "none=mover:gives=nothing", "persistence",
    )  # fmt: skip
    for stratum in FLOW_STRATA:
        right, still = found["right"][stratum], found["still"][stratum]
        assert right.flow_error == pytest.approx((0.0,) * (STEPS + 1), abs=1e-4)
        assert right.flow_coverage == still.flow_coverage == (1.0,) * (STEPS + 1)
        assert still.flow_error == right.flow_speed
        assert all(PEDESTRIAN_MPS - 0.2 < speed < CYCLIST_MPS + 1e-4 for speed in right.flow_speed)
        now = found["now"][stratum]
        assert now.flow_error == pytest.approx((0.0, *[None] * STEPS), abs=1e-4)
        assert now.flow_coverage == (1.0, *[0.0] * STEPS)
        for label in ("persistence", "oracle", "none"):
            assert found[label][stratum].flow_error is None, "its forecasts have no velocities"
    one = found["cyclist"]["occluded"]
    assert one.flow_error == pytest.approx((0.0,) * (STEPS + 1), abs=1e-4)
    assert all(0.1 < share < 0.9 for share in one.flow_coverage), "the pedestrian has no velocity"
    assert found["late"]["dynamic"].flow_coverage == (1.0,) * (STEPS + 1), "counted from its first velocity on"
    assert found["right"]["visible"].flow_error is None
    assert (tmp_path / "run" / "right@room" / FLOW_TABLE.file).exists()
    assert not (tmp_path / "run" / "persistence@room" / FLOW_TABLE.file).exists()


def test_without_ground_truth_velocities_are_not_scored(strata, tmp_path):
    found = strata("mover", with_truth=False)
    assert found["mover"]["dynamic"].flow_error is None
    assert not (tmp_path / "run" / "mover@room" / FLOW_TABLE.file).exists()


def test_sampled_futures_have_an_energy_score_with_and_without_ground_truth(strata, tmp_path):
    trackers = "alike=guesser", "mixed=guesser:gives=mixed", "sometimes=guesser:gives=sometimes", "persistence"
    found = strata(*trackers, with_truth=False)
    for stratum in ENERGY_STRATA:
        alike, mixed = found["alike"][stratum], found["mixed"][stratum]
        assert alike.energy_score[0] == 0.0, "step 0 has been seen"
        assert alike.energy_spread == (0.0,) * (STEPS + 1)
        assert min(mixed.energy_spread) > 0.0
        assert found["persistence"][stratum].energy_score is None, "its forecasts have no futures"
    assert found["mixed"]["dynamic"].energy_score[STEPS] < found["alike"]["dynamic"].energy_score[STEPS]
    assert found["alike"]["static"].energy_score is None
    assert (tmp_path / "run" / "alike@room" / ENERGY_TABLE.file).exists()
    assert not (tmp_path / "run" / "persistence@room" / ENERGY_TABLE.file).exists()
