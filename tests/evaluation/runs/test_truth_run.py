"""A run on a recording with truth: hidden cells, the oracle and classes."""

import numpy as np
import pytest

from gridtrack.common.errors import ConfigurationError
from gridtrack.evaluation.referee.strata import STRATA, STRATA_WITH_TRUTH
from gridtrack.evaluation.runs.plan import resolve
from gridtrack.evaluation.runs.runner import run
from gridtrack.evaluation.runs.settings import CompareSettings
from gridtrack.evaluation.runs.sums import TrialSums
from gridtrack.evaluation.scores.class_log_loss import confusion_of
from tests.conftest import PLUGINS
from tests.evaluation.conftest import RecordedProgress
from tests.scenes.room import curve

from scenes import truth_scene
from scenes.programs_here import programs_here
from scenes.room import trial_of
from studies.support.plugins import write_distribution

HORIZON_S, STEPS = 1.0, 10


def compare(folder, progress, *trackers, resume=False, **recording):
    """The summary of a run on the scene, and the run's folder."""
    path = folder / "room.mcap"
    if not resume:
        truth_scene.write_recording(path, **recording)
    settings = CompareSettings(
        no_floors=True,
        recordings=(str(path),),
        trackers=trackers,
        out=folder / "run",
        horizon_s=HORIZON_S,
        every_s=0.5,
        jobs=1,
        resume=resume,
    )
    with programs_here():
        return run(resolve(settings), (), progress), folder / "run"


@pytest.fixture(scope="module")
def complete(tmp_path_factory):
    """A run of four trackers without range noise: its summary and its folder."""
    site = tmp_path_factory.mktemp("site")
    points = {"classifier": "classifier:Classifier", "stranger": "classifier:Stranger"}
    files = {"classifier.py": (PLUGINS / "classifier.py").read_text()}
    write_distribution(site, "classifiers", points, files, group="gridtrack.trackers")
    with pytest.MonkeyPatch.context() as patched:
        patched.syspath_prepend(str(site))
        trackers = ("persistence", "blank", "classifier", "stranger")
        yield compare(tmp_path_factory.mktemp("run"), RecordedProgress(), *trackers)


def test_with_truth_hidden_cells_are_scored_and_the_oracle_is_the_ceiling(complete):
    summary, folder = complete
    oracle = trial_of(summary, "oracle")
    assert oracle.outcome == "ok"
    assert oracle.frames_scored == oracle.frames_expected == trial_of(summary, "persistence").frames_scored
    assert set(oracle.strata) >= set(STRATA_WITH_TRUTH)
    for stratum in ("visible", "dynamic", "static", "occluded", "occluded dynamic"):
        assert curve(oracle, stratum, "f1.f1") == (1.0,) * (STEPS + 1), "nothing is noisy in this recording"
    f1 = {name: curve(trial_of(summary, "persistence"), name, "f1.f1") for name in STRATA_WITH_TRUTH}
    assert f1["visible"][0] == 1.0, "on visible cells step 0 is copying"
    assert f1["occluded dynamic"][0] < 0.2, "hidden objects are not where they were last seen"
    assert 0.0 < f1["dynamic"][STEPS] < 1.0
    assert summary.recordings["room"].parity is True
    assert TrialSums(folder / "persistence@room").layouts["f1"].strata == STRATA_WITH_TRUTH


def test_the_oracle_misses_only_range_noise_and_no_tracker_has_a_lower_log_loss(tmp_path, progress):
    trackers = "blank", "persistence", "static-map"
    summary, _ = compare(tmp_path, progress, *trackers, noise_m=0.04)
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
    again, _ = compare(tmp_path, progress, *trackers, resume=True)
    assert trial_of(again, "oracle") == oracle
    assert progress.frames == {}, "the oracle is kept like the trackers"


def test_static_cells_are_the_outlines_of_static_objects(complete):
    """A waiting cyclist is not static, though it occupies its cells in every frame: only the scene shows it."""
    summary, _ = complete
    assert min(curve(trial_of(summary, "persistence"), "static", "f1.recall")) > 0.9


def test_a_recording_without_truth_has_no_oracle_and_no_occluded_strata(tmp_path, progress):
    summary, _ = compare(tmp_path, progress, "persistence", with_truth=False, seconds=12)
    assert set(summary.trackers) == {"persistence"}
    strata = tuple(trial_of(summary, "persistence").strata)
    assert strata[: len(STRATA)] == STRATA
    assert all(name.startswith("contacts ") for name in strata[len(STRATA) :])
    assert "class_log_loss" not in trial_of(summary, "persistence").strata["visible"]


def test_no_tracker_may_have_the_label_of_the_oracle(tmp_path, progress):
    with pytest.raises(ConfigurationError, match="'oracle' is the referee's own row"):
        compare(tmp_path, progress, "Oracle=blank", seconds=4)


def test_the_share_of_the_way_to_the_oracle_is_0_at_the_floor_and_below_it_negative(complete):
    summary, _ = complete

    def at(label, output, stratum="dynamic", step=STEPS):
        return (curve(trial_of(summary, label), stratum, output) or [None] * (STEPS + 1))[step]

    floor = at("persistence", "f1.f1")
    assert at("persistence", "f1.oracle_share") == 0.0
    assert at("blank", "f1.oracle_share") == pytest.approx(-floor / (1 - floor), abs=1e-5)
    assert at("oracle", "f1.oracle_share") is None
    losses = {label: at(label, "log_loss.mean") for label in ("blank", "persistence", "oracle")}
    assert losses["blank"] < losses["persistence"], "each score has its own best floor"
    share = (losses["blank"] - losses["persistence"]) / (losses["blank"] - losses["oracle"])
    assert at("blank", "log_loss.oracle_share") == 0.0
    assert at("persistence", "log_loss.oracle_share") == pytest.approx(share, abs=1e-4)


def confusion_at(folder, label, kind, step):
    """The confusion matrix (K, K+1) of a trial: true by most probable class."""
    sums = TrialSums(folder / f"{label}@room")
    return confusion_of(sums.by_frame("class_log_loss", [step], [kind], ())).sum(axis=(0, 1, 2))


def test_classes_are_scored_over_the_wire_by_name_at_every_step(complete):
    summary, folder = complete
    assert curve(trial_of(summary, "persistence"), "visible", "class_log_loss.per_scan") is None
    classifier = trial_of(summary, "classifier")
    for kind in ("visible", "occluded"):
        scores = {
            name: curve(classifier, kind, f"class_log_loss.{name}")
            for name in ("per_scan", "summed_over_scans", "per_cell", "balanced_accuracy", "cells", "scans")
        }
        for step in (0, 5, 10):
            cells = confusion_at(folder, "classifier", kind, step)
            right = cells[:, :3].diagonal()
            assert right[:2].tolist() == cells[:2].sum(axis=1).tolist(), "road users stay in their bands"
            accuracy = (2 + right[2] / cells[2].sum()) / 3
            assert scores["balanced_accuracy"][step] == pytest.approx(accuracy, abs=1e-6)
            by_hand = -(right.sum() * np.log(0.8) + (cells.sum() - right.sum()) * np.log(0.1)) / cells.sum()
            assert scores["per_cell"][step] == pytest.approx(by_hand, abs=1e-6)
            assert scores["cells"][step] == cells.sum()
        assert scores["summed_over_scans"][0] == pytest.approx(scores["per_scan"][0] * scores["scans"][0])


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


def test_recall_by_class_is_the_recall_of_its_dynamic_cells(complete):
    summary, _ = complete
    recall = {name: curve(trial_of(summary, "persistence"), name, "class_recall.recall") for name in (
        "dynamic cyclist", "occluded pedestrian",
    )}  # fmt: skip
    assert recall["dynamic cyclist"][0] == 1.0, "step 0 of visible cells is copying"
    assert recall["dynamic cyclist"][STEPS] < 0.6, "it has ridden on by then"
    assert 0.0 < recall["occluded pedestrian"][0] < 0.5
    cells = curve(trial_of(summary, "persistence"), "dynamic static", "class_recall.cells")
    assert not any(cells), "static objects are not in dynamic cells"
