"""Occluded cells at three thresholds: differences from the reference, from the counts of each frame."""

from __future__ import annotations

import numpy as np
import pytest

from gridtrack.evaluation.runs.trial_record import ThresholdsUsed, TrialRecord
from gridtrack.evaluation.scoring.counting import Tally
from gridtrack.evaluation.scoring.histograms import read_called
from gridtrack.evaluation.scoring.score_store import ScoresError, ScoreWriter
from gridtrack.evaluation.referee.strata import STRATA_WITH_TRUTH
from gridtrack.evaluation.scoring.thresholds import Thresholds, bins_of
from gridtrack.evaluation.statistics.finished_trial import FinishedTrial
from gridtrack.evaluation.statistics.occluded_statistics import OccludedStatistics
from gridtrack.evaluation.statistics.run_statistics import RunStatistics

from scenes import synthetic_run as synthetic

STEPS = synthetic.STEPS
OCCLUDED, VISIBLE = (STRATA_WITH_TRUTH.index(name) for name in ("occluded", "visible"))
OWN, SEEN = 0.1, 0.3
"""Thresholds of occluded and of visible cells."""
LOW, MIDDLE, HIGH = 0.2, 0.4, 0.7
"""Probabilities that are above the first threshold, above both, and above 0.5 too."""


def bin_of(probability):
    return int(bins_of(np.array(probability)))


def write(run, label, recording, found, *, frames=4, seed=0, cells=100, false=0):
    """A trial whose occupied hidden cells, about `cells`, have these shares at LOW, MIDDLE and HIGH, with as many false
    alarms; `false` more of them are at HIGH."""
    folder = run / f"{label}@{recording}"
    folder.mkdir(parents=True)
    bins = np.full((STEPS + 1, len(STRATA_WITH_TRUTH)), bin_of(0.5))
    bins[:, OCCLUDED], bins[:, VISIBLE] = bin_of(OWN), bin_of(SEEN)
    thresholds = Thresholds(bins, "room@0s-15s", STRATA_WITH_TRUTH)
    rng = np.random.default_rng(seed)
    with ScoreWriter(folder, STEPS, thresholds) as scores:
        for frame in range(frames):
            tally = Tally.empty(STEPS, STRATA_WITH_TRUTH)
            occupied = int(rng.poisson(cells))
            for probability, share in zip((LOW, MIDDLE, HIGH), found, strict=True):
                hits = round(share * occupied)
                tally.positives[:, OCCLUDED, bin_of(probability)] = hits
                tally.cells[:, OCCLUDED, bin_of(probability)] = 2 * hits
            tally.cells[:, OCCLUDED, bin_of(HIGH)] += false
            missed = occupied - int(tally.positives[0, OCCLUDED].sum())
            tally.positives[:, OCCLUDED, 0], tally.cells[:, OCCLUDED, 0] = missed, missed + 1000
            tally.log_loss[:, OCCLUDED] = 100.0 * found[2]
            scores.add((frame + 10) * 10**9, f"{frame:032x}", tally, (frame + 10) * 10**9)
    record = TrialRecord(
        label=label, recording=recording, outcome="ok", frames_scored=frames, frames_expected=frames, steps=STEPS,
        thresholds=ThresholdsUsed.model_validate(thresholds.used()), **synthetic.DESCRIBED.get(label, {}),
    )  # fmt: skip
    return FinishedTrial(record, folder, label, {}, "centres")


@pytest.fixture(scope="module")
def differences(tmp_path_factory):
    """`low` knows where hidden objects may be and says so carefully; the reference is sure and finds fewer."""
    run = tmp_path_factory.mktemp("runs")
    names = [f"room-{number:02}" for number in range(20)]
    trials = []
    for seed, name in enumerate(names):
        trials.append(write(run, "persistence", name, (0.0, 0.0, 0.4), seed=seed))
        trials.append(write(run, "low", name, (0.8, 0.0, 0.0), seed=seed))
        trials.append(write(run, "oracle", name, (0.0, 0.0, 1.0), seed=seed))
    recordings = {name: synthetic.description(source_sha256=name) for name in names}
    return OccludedStatistics(RunStatistics(recordings, trials)).differences()


def test_the_ranking_on_occluded_cells_turns_round_with_the_threshold_and_each_is_tested(differences):
    (found,) = differences
    assert (found.tracker, found.reference, found.recordings) == ("low", "persistence", "all recordings")
    assert (found.units, found.interval) == (20, "")
    at = {name: (score.value[8], score.p[8]) for name, score in found.scores.items()}
    # 2 TP / (2 TP + FP + FN) with as many false alarms as hits: 2 s / (2 s + 1 - s + s) = 2 s / (2 s + 1)
    assert at["f1"][0] == pytest.approx(1.6 / 2.6 - 0.8 / 1.8, abs=0.01)
    assert at["f1_at_visible"][0] == at["f1_at_half"][0] == pytest.approx(-0.8 / 1.8, abs=0.01)
    assert at["nll"][0] < 0
    assert all(p < 0.001 for _, p in at.values())


def test_f1_without_an_occupied_hidden_cell_is_undefined_and_has_no_p_value(tmp_path):
    names = [f"room-{number:02}" for number in range(20)]
    rows = ("persistence", 20), ("low", 30)
    trials = [write(tmp_path, row, name, (0, 0, 0.4), cells=0, false=n) for name in names for row, n in rows]
    recordings = {name: synthetic.description(source_sha256=name) for name in names}
    (found,) = OccludedStatistics(RunStatistics(recordings, trials)).differences()
    for name in ("f1", "f1_at_visible", "f1_at_half"):
        assert (found.scores[name].value[8], found.scores[name].p[8]) == (None, None), name
    assert found.scores["nll"].p[8] is not None


def test_cells_called_occupied_are_those_of_the_histogram_of_each_frame(tmp_path):
    trial = write(tmp_path, "low", "room", (0.5, 0.3, 0.1), frames=3)
    stamps = np.array([10, 11, 12]) * 10**9
    bins = np.tile([[bin_of(OWN)], [bin_of(SEEN)], [bin_of(0.5)]], (1, STEPS + 1))
    called = read_called(trial.folder, stamps, STEPS, "occluded", bins)
    assert called.shape == (3, 3, STEPS + 1, 2)
    assert (called[..., 0] == 2 * called[..., 1]).all()
    assert (called[0] > called[1]).all()
    assert (called[1] > called[2]).all()
    with pytest.raises(ScoresError, match=r"other frames than in scores\.parquet"):
        read_called(trial.folder, stamps + 1, STEPS, "occluded", bins)
