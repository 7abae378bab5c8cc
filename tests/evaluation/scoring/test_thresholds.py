"""Thresholds: one per step and stratum, its best F1 on the validation stretch."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from sklearn.metrics import f1_score

from gridtrack.evaluation.results.columns import PROBABILITY_BINS, PROBABILITY_EDGES
from gridtrack.evaluation.scoring.counting import Tally
from gridtrack.evaluation.referee.strata import STRATA
from gridtrack.evaluation.scoring.thresholds import best_thresholds, half

VISIBLE = STRATA.index("visible")


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


def test_a_blurred_forecast_gets_a_low_threshold():
    blurred = np.zeros(PROBABILITY_BINS, np.int64)
    blurred[PROBABILITY_EDGES.searchsorted(0.1)] = 7
    free = np.zeros(PROBABILITY_BINS, np.int64)
    free[0] = 100
    assert 0.02 <= best_thresholds(tally_of(blurred, free), "v").values[0, VISIBLE] <= 0.2


def test_without_a_validation_stretch_thresholds_are_one_half():
    assert (half(2).values == 0.5).all()
    assert half(2).chosen_on == ""
