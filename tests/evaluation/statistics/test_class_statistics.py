"""What a run says of classes: intervals of the log loss, and each tracker against one-shot on the same scans."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from gridtrack.evaluation.scoring.class_store import ClassWriter
from gridtrack.evaluation.statistics.summary import summarise

from scenes import synthetic_run as synthetic

CLASSES = ("pedestrian", "car")
FRAMES, CELLS = 4, 5
RECORDINGS = [f"seed-{i:02}" for i in range(20)]
RNG = np.random.default_rng(0)
HARD = 1.0 + RNG.random((len(RECORDINGS), FRAMES))
"""Loss of every scan, by recording: what a tracker adds to it is its own."""


def trial(folder, label, number, extra, seen=range(FRAMES), tracker="", **how):
    """A trial whose scans cost HARD + `extra` nats a cell, at every step, on visible cells only."""
    ended = synthetic.write_trial(
        folder, label, RECORDINGS[number], 0.6, seed=number, frames=FRAMES, tracker=tracker, **how
    )
    if extra is not None:
        with ClassWriter(ended.folder, CLASSES, semantics=True) as writer:
            confusion = np.zeros((synthetic.STEPS + 1, 2, 2, 3), np.int32)
            confusion[:, 0, 1, 0] = CELLS
            for frame in seen:
                stamp_ns = (frame + 10) * 1_000_000_000  # as synthetic_run stamps them
                writer.add_semantics(stamp_ns, confusion, confusion * (HARD[number, frame] + extra[number]))
            writer.add_found(10_000_000_000, np.ones((synthetic.STEPS + 1, 2, 2, 4), np.int32))
    return ended


EXTRA = {"latent": 0.3 + 0.1 * RNG.random(len(RECORDINGS)), "shot": np.zeros(len(RECORDINGS)), "persistence": None}


def summary_of(trials, names, classes=CLASSES, reference=None):
    described = {name: synthetic.description(FRAMES, classes=classes) for name in names}
    return summarise(described, trials, [], False, reference)


@pytest.fixture(scope="module")
def trials(tmp_path_factory):
    folder = tmp_path_factory.mktemp("classes")
    return [
        trial(folder, label, number, extra, tracker="one-shot" if label == "shot" else "")
        for number in range(len(RECORDINGS))
        for label, extra in EXTRA.items()
    ]


def test_the_log_loss_of_scans_has_the_interval_of_the_jackknife_over_recordings(trials):
    visible = summary_of(trials, RECORDINGS).trackers["shot"].pooled.semantics.kinds["visible"]
    sums = HARD.sum(axis=1)
    without = np.log(sums.sum() - sums)
    error = np.sqrt(19 / 20 * np.sum((without - without.mean()) ** 2))
    reach = stats.t.ppf(0.975, sums.sum() ** 2 / (sums**2).sum() - 1) * error
    assert visible.nll_per_scan[8] == pytest.approx(HARD.mean(), abs=1e-5)
    assert visible.nll_per_scan_low[8] == pytest.approx(HARD.mean() * np.exp(-reach), abs=1e-5)
    assert visible.nll_per_scan_high[8] == pytest.approx(HARD.mean() * np.exp(reach), abs=1e-5)
    assert visible.interval == ""


def test_each_tracker_that_gives_classes_is_set_against_one_shot_on_the_same_scans(trials):
    (one,) = summary_of(trials, RECORDINGS).class_differences
    extra = EXTRA["latent"]
    error = extra.std(ddof=1) / np.sqrt(20)  # units of equal size: the jackknife is the error of the mean
    reach = stats.t.ppf(0.975, 19) * error
    assert (one.tracker, one.reference, one.recordings) == ("latent", "shot", "all recordings")
    assert (one.units, one.frames, one.interval) == (20, 20 * FRAMES, "")
    at_step_8 = {key: curve[8] for key, curve in one.kinds["visible"]}
    visible = SimpleNamespace(**at_step_8)
    assert visible.nll_per_scan == pytest.approx(extra.mean(), abs=1e-5)
    assert visible.nll_per_scan_low == pytest.approx(extra.mean() - reach, abs=1e-5)
    assert visible.nll_per_scan_high == pytest.approx(extra.mean() + reach, abs=1e-5)
    assert 0 < visible.nll_per_scan_p < 1e-9
    assert set(one.kinds["occluded"].nll_per_scan) == {None}


def test_a_reference_asked_for_that_gives_classes_is_the_reference(trials):
    (one,) = summary_of(trials, RECORDINGS, reference="latent").class_differences
    assert (one.tracker, one.reference) == ("shot", "latent")
    assert one.kinds["visible"].nll_per_scan[0] < 0


def test_the_classes_are_no_part_of_the_headline_family(trials):
    tests = [test for one in summary_of(trials, RECORDINGS).differences for test in one.headline]
    assert {test.stratum for test in tests} == {"in-motion", "dynamic", "visible"}


def test_one_short_recording_has_no_interval_and_says_why(trials):
    summary = summary_of([t for t in trials if t.record.recording == RECORDINGS[0]], RECORDINGS[:1])
    visible = summary.trackers["shot"].recordings[RECORDINGS[0]].semantics.kinds["visible"]
    assert visible.nll_per_scan_low is None
    assert visible.interval.startswith("too short for an interval: ")
    (one,) = summary.class_differences
    assert one.interval.startswith("too short for an interval: ")
    assert one.kinds["visible"].nll_per_scan[0] == pytest.approx(EXTRA["latent"][0], abs=1e-5)


def test_a_tracker_that_was_shown_other_frames_is_not_paired(tmp_path):
    pair = [trial(tmp_path, "shot", 0, EXTRA["shot"]), trial(tmp_path, "latent", 0, EXTRA["latent"], delivered="f")]
    summary = summary_of(pair, RECORDINGS[:1])
    assert summary.class_differences == ()
    assert any("latent on seed-00 was delivered other frames" in notice for notice in summary.notices)


def test_nobody_is_compared_where_the_classes_are_not_known_or_only_one_gives_them(trials, tmp_path):
    assert summary_of(trials, RECORDINGS, classes=()).class_differences == ()
    assert summary_of([trial(tmp_path, "shot", 0, EXTRA["shot"])], RECORDINGS[:1]).class_differences == ()
