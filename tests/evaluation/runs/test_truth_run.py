"""A run on a recording with truth: hidden cells, the oracle, and the optional parts of forecasts."""

import numpy as np
import pytest

from gridtrack.common.errors import ConfigurationError
from gridtrack.evaluation.referee.strata import STRATA, STRATA_WITH_TRUTH
from gridtrack.evaluation.runs.plan import resolve
from gridtrack.evaluation.runs.runner import run
from gridtrack.evaluation.runs.settings import CompareSettings
from gridtrack.evaluation.runs.sums import TrialSums
from gridtrack.evaluation.scores.class_log_loss import confusion_of
from gridtrack.evaluation.scores.energy import ENERGY_STRATA
from gridtrack.evaluation.scores.flow_error import FLOW_STRATA
from tests.conftest import PLUGINS
from tests.evaluation.conftest import RecordedProgress

from scenes import truth_scene
from scenes.programs_here import programs_here
from scenes.room import curve, trial_of
from studies.support.plugins import write_distribution

pytestmark = pytest.mark.usefixtures("trackers_here")

STEPS = 10
CYCLIST_MPS, PEDESTRIAN_MPS = 4 * 2.8 / 5.0, 4 * 3.4 / 8.0


@pytest.fixture(scope="module")
def complete(tmp_path_factory):
    """A run of four trackers without range noise: its summary and its folder."""
    site, folder = tmp_path_factory.mktemp("site"), tmp_path_factory.mktemp("run")
    points = {"classifier": "classifier:Classifier", "stranger": "classifier:Stranger"}
    files = {"classifier.py": (PLUGINS / "classifier.py").read_text()}
    write_distribution(site, "classifiers", points, files, group="gridtrack.trackers")
    recordings = (str(truth_scene.write_recording(site / "room.mcap")),)
    trackers = ("persistence", "blank", "classifier", "stranger")
    given = {"horizon_s": 1.0, "every_s": 0.5, "jobs": 1, "no_floors": True, "out": folder}
    with pytest.MonkeyPatch.context() as patched, programs_here():
        patched.syspath_prepend(str(site))
        settings = CompareSettings(recordings=recordings, trackers=trackers, **given)
        return run(resolve(settings), (), RecordedProgress()), folder


@pytest.fixture
def scene(tmp_path):
    """`scene(**how)` writes a recording of the scene; the setting that names it."""
    return lambda **how: {"recordings": (str(truth_scene.write_recording(tmp_path / "room.mcap", **how)),)}


def test_with_truth_hidden_cells_are_scored_and_the_oracle_is_the_ceiling(complete):
    summary, folder = complete
    oracle = trial_of(summary, "oracle")
    assert oracle.outcome == "ok"
    assert oracle.frames_scored == oracle.frames_expected == trial_of(summary, "persistence").frames_scored
    assert set(oracle.strata) >= set(STRATA_WITH_TRUTH)
    for stratum in ("visible", "dynamic", "static", "occluded", "occluded dynamic"):
        assert curve(oracle, stratum, "f1.f1") == (1.0,) * (STEPS + 1), "nothing is noisy in this recording"
    persistence = trial_of(summary, "persistence")
    f1 = {name: curve(persistence, name, "f1.f1") for name in STRATA_WITH_TRUTH}
    assert f1["visible"][0] == 1.0, "on visible cells step 0 is copying"
    assert f1["occluded dynamic"][0] < 0.2, "hidden objects are not where they were last seen"
    assert 0.0 < f1["dynamic"][STEPS] < 1.0
    assert curve(persistence, "dynamic cyclist", "class_recall.recall")[0] == 1.0
    assert summary.recordings["room"].parity is True
    assert TrialSums(folder / "persistence@room").layouts["f1"].strata == STRATA_WITH_TRUTH


def test_the_oracle_misses_only_range_noise_and_no_tracker_has_a_lower_log_loss(compare, scene, progress):
    trackers, noisy = ("blank", "persistence", "static-map"), scene(noise_m=0.04)
    summary = compare(*trackers, **noisy)
    oracle = trial_of(summary, "oracle")
    assert all(0.7 < f1 < 0.99 for f1 in curve(oracle, "dynamic", "f1.f1"))
    assert curve(oracle, "occluded", "f1.f1") == (1.0,) * (STEPS + 1)
    assert oracle.threshold_chosen_on == "room.mcap@validation", "as for every tracker"
    for label in summary.trackers.keys() - {"oracle"}:
        for stratum in STRATA_WITH_TRUTH:
            own, best = (curve(trial_of(summary, one), stratum, "log_loss.mean")[1:] for one in (label, "oracle"))
            pairs = zip(own, best, strict=True)
            assert all(loss is None or loss >= least for loss, least in pairs), "step 0 alone can be copied"
    progress.frames.clear()
    assert trial_of(compare(*trackers, **noisy, resume=True), "oracle") == oracle
    assert progress.frames == {}, "the oracle is kept like the trackers"


def test_static_cells_are_the_outlines_of_static_objects(complete):
    """A waiting cyclist is not static, though it occupies its cells in every frame: only the scene shows it."""
    summary, _ = complete
    assert min(curve(trial_of(summary, "persistence"), "static", "f1.recall")) > 0.9


def test_a_recording_without_truth_has_no_oracle_and_no_occluded_strata(compare, scene):
    summary = compare("persistence", **scene(with_truth=False, seconds=12))
    assert set(summary.trackers) == {"persistence"}
    strata = tuple(trial_of(summary, "persistence").strata)
    assert strata[: len(STRATA)] == STRATA
    assert all(name.startswith("contacts ") for name in strata[len(STRATA) :])
    assert "class_log_loss" not in trial_of(summary, "persistence").strata["visible"]


def test_no_tracker_may_have_the_label_of_the_oracle(settings, scene):
    with pytest.raises(ConfigurationError, match="'oracle' is the referee's own row"):
        resolve(settings("Oracle=blank", **scene(seconds=4)))


def confusion_at(folder, label, kind, step):
    """The confusion matrix (K, K+1) of a trial: true by most probable class."""
    sums = TrialSums(folder / f"{label}@room")
    return confusion_of(sums.by_frame("class_log_loss", [step], [kind], ())).sum(axis=(0, 1, 2))


def test_classes_are_scored_over_the_wire_by_name_at_every_step(complete):
    summary, folder = complete
    assert curve(trial_of(summary, "persistence"), "visible", "class_log_loss.per_scan") is None
    classifier = trial_of(summary, "classifier")
    for kind in ("visible", "occluded"):
        per_cell = curve(classifier, kind, "class_log_loss.per_cell")
        for step in (0, 5, 10):
            cells = confusion_at(folder, "classifier", kind, step)
            right = cells[:, :3].diagonal()
            assert right[:2].tolist() == cells[:2].sum(axis=1).tolist(), "road users stay in their bands"
            by_hand = -(right.sum() * np.log(0.8) + (cells.sum() - right.sum()) * np.log(0.1)) / cells.sum()
            assert per_cell[step] == pytest.approx(by_hand, abs=1e-6)


def test_a_class_that_a_tracker_lacks_gives_a_notice_and_counts_as_misclassified(complete):
    summary, folder = complete
    assert [notice for notice in map(str, summary.notices) if "stranger" in notice] == [
        "stranger on room: does not forecast the classes cyclist, static: their cells count as misclassified, with"
        " probability 0"
    ]
    confusion = confusion_at(folder, "stranger", "visible", 0)
    cyclist, static = truth_scene.CLASSES.index("cyclist"), truth_scene.CLASSES.index("static")
    assert confusion[static, :3].sum() < 0.2 * confusion[static].sum(), "most get a class that the recording lacks"
    assert confusion[[cyclist, static], [cyclist, static]].sum() == 0


def test_velocities_are_scored_against_the_true_ones(movers, compare, scene, tmp_path):
    trackers = "right=mover", "still=mover:scale=0", "now=mover:gives=now", "none=mover:gives=nothing", "persistence"
    rows = compare(*trackers, **scene(seconds=14)).trackers
    for stratum in FLOW_STRATA:
        error, speed, coverage = (
            {label: curve(row.recordings["room"], stratum, f"flow_error.{output}") for label, row in rows.items()}
            for output in ("mean", "true_speed", "coverage")
        )
        assert error["right"] == pytest.approx((0.0,) * (STEPS + 1), abs=1e-4)
        assert coverage["right"] == coverage["still"] == (1.0,) * (STEPS + 1)
        assert error["still"] == speed["right"]
        assert all(PEDESTRIAN_MPS - 0.2 < mps < CYCLIST_MPS + 1e-4 for mps in speed["right"])
        assert error["now"] == pytest.approx((0.0, *[None] * STEPS), abs=1e-4)
        assert coverage["now"] == (1.0, *[0.0] * STEPS)
        assert {error[label] for label in ("persistence", "oracle", "none")} == {None}, "forecasts without velocities"
    scored = {label: "flow_error" in TrialSums(tmp_path / "run" / f"{label}@room").scores for label in rows}
    assert scored == {**dict.fromkeys(rows, False), "right": True, "still": True, "now": True}


def test_sampled_futures_have_an_energy_score_with_and_without_ground_truth(movers, compare, scene, tmp_path):
    trackers = "alike=guesser", "mixed=guesser:gives=mixed", "sometimes=guesser:gives=sometimes", "persistence", "mover"
    summary = compare(*trackers, **scene(seconds=14, with_truth=False))
    alike, mixed, sometimes, persistence, mover = (trial_of(summary, one.partition("=")[0]) for one in trackers)
    reason = "unlike in the first one: a tracker gives futures in all of its forecasts or in none"
    assert (sometimes.outcome, reason in sometimes.reason) == ("invalid-output", True)
    assert curve(mover, "dynamic", "flow_error.mean") is None, "velocities are scored with ground truth only"
    for stratum in ENERGY_STRATA:
        assert curve(alike, stratum, "energy.score")[0] == 0.0, "step 0 has been seen"
        assert curve(alike, stratum, "energy.spread") == (0.0,) * (STEPS + 1)
        assert min(curve(mixed, stratum, "energy.spread")) > 0.0
        assert curve(persistence, stratum, "energy.score") is None, "its forecasts have no futures"
    assert curve(mixed, "dynamic", "energy.score")[STEPS] < curve(alike, "dynamic", "energy.score")[STEPS]
    assert "energy" not in TrialSums(tmp_path / "run" / "persistence@room").scores
