"""Thresholds: the best F1 of each step and stratum on the validation stretch, and label-free ones."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from sklearn.metrics import f1_score

from gridtrack.evaluation.referee.strata import STRATA
from gridtrack.evaluation.scores.cells import CALIBRATION_EDGES, HALF, PROBABILITY_BINS, PROBABILITY_EDGES, Tally
from gridtrack.evaluation.scores.f1 import f1_of
from gridtrack.evaluation.scores.thresholds import LabelFreeThresholds, best_thresholds, half

VISIBLE, DYNAMIC = (STRATA.index(name) for name in ("visible", "dynamic"))


def tally_of(positives, negatives):
    """A tally of step 0 with these counts (B,) on visible cells, and misleading ones elsewhere."""
    tally = Tally.empty(0)
    tally.positives[0] = np.asarray(negatives)[None]
    tally.cells[0] = np.asarray(positives)[None] + np.asarray(negatives)[None]
    tally.positives[0, VISIBLE] = positives
    return tally


counts = arrays(np.int64, PROBABILITY_BINS, elements=st.integers(0, 3))


@settings(max_examples=20, deadline=None)
@given(counts, counts)
def test_no_threshold_has_a_better_f1_in_its_stratum(positives, negatives):
    chosen = best_thresholds(tally_of(positives, negatives), "validation").bins[0, VISIBLE]
    truth = np.repeat([True, False], [positives.sum(), negatives.sum()])
    bins = np.concatenate(
        [np.repeat(np.arange(PROBABILITY_BINS), positives), np.repeat(np.arange(PROBABILITY_BINS), negatives)]
    )

    def f1(threshold):
        return f1_score(truth, bins >= threshold, zero_division=0.0) if truth.any() else 0.0

    assert 1 <= chosen < PROBABILITY_BINS
    some = range(1, PROBABILITY_BINS, 7)
    assert f1(chosen) >= max(f1(b) for b in some) - 1e-12


def test_a_binary_forecast_gets_one_half():
    ones = np.eye(1, PROBABILITY_BINS, PROBABILITY_BINS - 1, dtype=np.int64)[0]
    zeros = np.eye(1, PROBABILITY_BINS, 0, dtype=np.int64)[0]
    assert best_thresholds(tally_of(5 * ones + zeros, 2 * ones + 9 * zeros), "v").values[0, VISIBLE] == 0.5


def test_a_step_without_occupied_cells_gets_one_half():
    assert best_thresholds(Tally.empty(3), "v").values.tolist() == half(3).values.tolist()


def cells_of(p, occupied):
    """A tally of step 0 with these cells (N,) in the dynamic stratum."""
    tally = Tally.empty(0)
    bins = PROBABILITY_EDGES[1:-1].searchsorted(p, side="right")
    tally.cells[0, DYNAMIC] = np.bincount(bins, minlength=PROBABILITY_BINS)
    tally.positives[0, DYNAMIC] = np.bincount(bins[occupied], minlength=PROBABILITY_BINS)
    coarse = CALIBRATION_EDGES[1:-1].searchsorted(p, side="right")
    tally.p_sum[0, DYNAMIC] = np.bincount(coarse, weights=p, minlength=len(CALIBRATION_EDGES) - 1)
    return tally


def drawn(seed, cells=20_000):
    rng = np.random.default_rng(seed)
    p = rng.beta(0.1, 3.0, cells).astype(np.float32)
    return p, rng.random(cells) < p


def test_the_expected_f1_is_maximised_over_the_edges_by_brute_force():
    p, occupied = drawn(0)
    thresholds = LabelFreeThresholds(0, STRATA)
    thresholds.add(10, cells_of(p, occupied))
    chosen = PROBABILITY_EDGES[thresholds.bins(10)[0, DYNAMIC]]

    def expected(edge):
        called = p >= edge
        return 2 * p[called].sum() / (called.sum() + p.sum())

    assert chosen in CALIBRATION_EDGES
    assert expected(chosen) >= max(expected(edge) for edge in CALIBRATION_EDGES[1:-1]) - 1e-6


def test_the_threshold_of_a_calibrated_forecast_is_nearly_as_good_as_the_best_one():
    before, now = cells_of(*drawn(1)), cells_of(*drawn(2))
    thresholds = LabelFreeThresholds(0, STRATA)
    thresholds.add(10, before)
    f1, best, at_half = (
        f1_of(now.confusion(bins))[0, DYNAMIC]
        for bins in (thresholds.bins(10), best_thresholds(now, "").bins, np.full((1, len(STRATA)), HALF))
    )
    assert f1 > best - 0.02
    assert f1 > at_half + 0.05


def test_observations_in_the_cells_do_not_matter():
    p, occupied = drawn(3)
    found = []
    for labels in (occupied, ~occupied):
        thresholds = LabelFreeThresholds(0, STRATA)
        thresholds.add(10, cells_of(p, labels))
        found.append(thresholds.bins(10).tolist())
    assert found[0] == found[1]


def test_a_forecast_is_not_used_before_its_last_frame_is_observed():
    thresholds = LabelFreeThresholds(0, STRATA)
    thresholds.add(10, cells_of(*drawn(4)))
    assert thresholds.bins(9)[0].tolist() == [HALF] * len(STRATA)
    later = thresholds.bins(10)[0]
    assert later[DYNAMIC] < HALF
    assert later[STRATA.index("static")] == HALF
