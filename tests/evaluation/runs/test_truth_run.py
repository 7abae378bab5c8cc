"""A run on a recording with truth: hidden cells, the oracle and classes."""

import os
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from gridtrack.common.errors import ConfigurationError
from gridtrack.evaluation.referee.strata import STRATA, STRATA_WITH_TRUTH
from gridtrack.evaluation.results.columns import SCORES_TABLE, SEMANTICS_TABLE
from gridtrack.evaluation.runs.plan import resolve
from gridtrack.evaluation.runs.runner import run
from gridtrack.evaluation.runs.settings import CompareSettings

from scenes import truth_scene

HORIZON_S, STEPS = 1.0, 10


def compare(folder, progress, *trackers, resume=False, **recording):
    """The summary of a run on the scene, and the run's folder."""
    path = folder / "room.mcap"
    if not resume:
        truth_scene.write_recording(path, **recording)
    settings = CompareSettings(
        recordings=(str(path),),
        trackers=trackers,
        out=folder / "run",
        horizon_s=HORIZON_S,
        every_s=0.5,
        jobs=1,
        resume=resume,
    )
    return run(resolve(settings), (), progress), folder / "run"


@pytest.fixture(scope="module")
def complete(tmp_path_factory):
    """A run of four trackers without range noise: its summary and its folder."""
    site = tmp_path_factory.mktemp("site")
    (site / "classifier.py").write_text((Path(__file__).parents[2] / "plugins" / "classifier.py").read_text())
    info = site / "classifiers-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.4\nName: classifiers\nVersion: 1.0\n")
    points = "classifier = classifier:Classifier\nstranger = classifier:Stranger\n"
    (info / "entry_points.txt").write_text(f"[gridtrack.trackers]\n{points}")
    with pytest.MonkeyPatch.context() as patched:
        patched.syspath_prepend(str(site))
        patched.setenv("PYTHONPATH", os.pathsep.join(filter(None, (str(site), os.environ.get("PYTHONPATH")))))
        yield compare(tmp_path_factory.mktemp("run"), Quiet(), "persistence", "blank", "classifier", "stranger")


class Quiet:
    """A progress that is not shown."""

    def note(self, text): ...

    def started(self, trial, frames): ...

    def planned(self, frames, then=()): ...
    def advanced(self, trial): ...

    def ended(self, trial, record): ...


def trial_of(summary, label):
    return summary.trackers[label].recordings["room"]


def test_with_truth_hidden_cells_are_scored_and_the_oracle_is_the_ceiling(complete):
    summary, folder = complete
    oracle = trial_of(summary, "oracle")
    assert oracle.outcome == "ok"
    assert oracle.frames_scored == oracle.frames_expected == trial_of(summary, "persistence").frames_scored
    assert tuple(oracle.strata) == STRATA_WITH_TRUTH
    for stratum in ("visible", "dynamic", "static", "occluded", "occluded dynamic"):
        assert oracle.strata[stratum].f1 == (1.0,) * (STEPS + 1), "nothing is noisy in this recording"
    persistence = trial_of(summary, "persistence").strata
    assert persistence["visible"].f1[0] == 1.0, "on what is seen, step 0 is copying"
    assert persistence["occluded dynamic"].f1[0] < 0.2, "what is not seen is not where it was last seen"
    assert 0.0 < persistence["dynamic"].f1[STEPS] < 1.0
    assert summary.recordings["room"].parity is True
    assert pl.read_parquet(folder / "persistence@room" / SCORES_TABLE.file)["stratum"].n_unique() == len(
        STRATA_WITH_TRUTH
    )


def test_the_oracle_misses_only_range_noise_and_no_tracker_has_a_lower_log_loss(tmp_path, progress):
    summary, _ = compare(tmp_path, progress, "blank", "persistence", "static-map", noise_m=0.04)
    oracle = trial_of(summary, "oracle")
    assert all(0.7 < f1 < 0.99 for f1 in oracle.strata["dynamic"].f1)
    assert oracle.strata["occluded"].f1 == (1.0,) * (STEPS + 1)
    assert oracle.threshold_chosen_on == "room.mcap@validation", "like those of every tracker"
    for label in summary.trackers.keys() - {"oracle"}:
        for stratum, scores in trial_of(summary, label).strata.items():
            for step in range(1, STEPS + 1):
                best = oracle.strata[stratum].nll[step]
                assert scores.nll[step] is None or scores.nll[step] >= best, "step 0 alone can be copied"


def test_static_cells_are_the_outlines_of_static_objects(complete):
    """A waiting cyclist is not static, though it occupies its cells in every frame: only the scene shows it."""
    summary, _ = complete
    recall = trial_of(summary, "persistence").strata["static"].recall
    assert min(recall) > 0.9


def test_a_recording_without_truth_has_no_oracle_and_no_occluded_strata(tmp_path, progress):
    summary, _ = compare(tmp_path, progress, "persistence", with_truth=False)
    assert set(summary.trackers) == {"persistence"}
    assert tuple(trial_of(summary, "persistence").strata) == STRATA
    assert trial_of(summary, "persistence").semantics is None


def test_a_resumed_run_keeps_its_oracle(tmp_path, progress):
    compare(tmp_path, progress, "blank", seconds=12)
    progress.frames.clear()
    summary, _ = compare(tmp_path, progress, "blank", resume=True)
    assert "oracle@room" not in progress.frames
    assert trial_of(summary, "oracle").outcome == "ok"


def test_no_tracker_may_have_the_label_of_the_oracle(tmp_path, progress):
    with pytest.raises(ConfigurationError, match="'oracle' is the referee's own row"):
        compare(tmp_path, progress, "Oracle=blank", seconds=12)


def test_the_share_of_the_way_to_the_oracle_is_0_at_the_floor_and_below_it_negative(complete):
    summary, _ = complete
    strata = {label: trial_of(summary, label).strata["dynamic"] for label in summary.trackers}
    floor = strata["persistence"].f1[STEPS]
    assert strata["persistence"].share_of_oracle[STEPS] == 0.0
    assert strata["blank"].share_of_oracle[STEPS] == pytest.approx(-floor / (1 - floor), abs=1e-5)
    assert strata["oracle"].share_of_oracle is None
    losses = {label: strata[label].nll[STEPS] for label in ("blank", "persistence", "oracle")}
    assert losses["blank"] < losses["persistence"], "the floor of log loss need not be that of F1"
    share = (losses["blank"] - losses["persistence"]) / (losses["blank"] - losses["oracle"])
    assert strata["blank"].share_of_oracle_nll[STEPS] == 0.0
    assert strata["persistence"].share_of_oracle_nll[STEPS] == pytest.approx(share, abs=1e-4)
    visible, occluded = (trial_of(summary, "persistence").strata[name].f1[3] for name in ("visible", "occluded"))
    assert trial_of(summary, "persistence").gap_to_truth[3] == pytest.approx(visible - occluded, abs=2e-6)


def test_classes_are_scored_over_the_wire_by_name_at_every_step(complete):
    summary, folder = complete
    assert trial_of(summary, "persistence").semantics is None
    semantics = trial_of(summary, "classifier").semantics
    assert semantics.classes == truth_scene.CLASSES
    for kind in ("visible", "occluded"):
        scores = semantics.kinds[kind]
        assert [matrix.step for matrix in scores.confusion] == [0, 5, 10]
        for matrix in scores.confusion:
            step, cells = matrix.step, np.array(matrix.cells)
            right = cells[:, :3].diagonal()
            assert right[:2].tolist() == cells[:2].sum(axis=1).tolist(), "road users stay in their bands"
            assert scores.balanced_accuracy[step] == pytest.approx((2 + right[2] / cells[2].sum()) / 3, abs=1e-6)
            by_hand = -(right.sum() * np.log(0.8) + (cells.sum() - right.sum()) * np.log(0.1)) / cells.sum()
            assert scores.nll_per_cell[step] == pytest.approx(by_hand, abs=1e-6)
            assert scores.cells[step] == cells.sum()
        assert scores.nll_summed_over_scans[0] == pytest.approx(scores.nll_per_scan[0] * scores.scans[0])
    stored = pl.read_parquet(folder / "classifier@room" / SEMANTICS_TABLE.file)
    assert stored["cells"].sum() == sum(sum(scores.cells) for scores in semantics.kinds.values())


def test_a_class_that_a_tracker_lacks_gives_a_notice_and_counts_as_misclassified(complete):
    summary, _ = complete
    assert [notice for notice in summary.notices if "stranger" in notice] == [
        "stranger does not forecast the classes cyclist, static of room: their cells count as misclassified,"
        " with probability 0"
    ]
    confusion = np.array(trial_of(summary, "stranger").semantics.kinds["visible"].confusion[0].cells)
    cyclist, static = truth_scene.CLASSES.index("cyclist"), truth_scene.CLASSES.index("static")
    assert confusion[static, :3].sum() < 0.2 * confusion[static].sum(), "most get a class that the recording lacks"
    assert confusion[[cyclist, static], [cyclist, static]].sum() == 0


def test_recall_by_class_is_that_of_dynamic_cells_of_the_class(complete):
    summary, _ = complete
    recall = trial_of(summary, "persistence").recall_by_class
    assert recall["visible"]["cyclist"].recall[0] == 1.0, "step 0 of what is seen is copying"
    assert recall["visible"]["cyclist"].recall[STEPS] < 0.6, "it has ridden on by then"
    assert 0.0 < recall["occluded"]["pedestrian"].recall[0] < 0.5
    assert sum(recall["visible"]["static"].cells) == 0, "static objects are not in dynamic cells"
