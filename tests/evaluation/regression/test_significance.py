"""The permutation test against the enumeration of every permutation, and on equal runs."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from gridtrack.evaluation.regression.significance import swap_test
from gridtrack.evaluation.scoring.metrics import f1_score


def counts(rng, units, rows, recall):
    """TP, FP, FN, TN (U, R, 4) of 100 occupied cells and as many false alarms as misses."""
    tp = rng.binomial(100, recall, (units, rows))
    return np.stack([tp, 100 - tp, 100 - tp, np.full_like(tp, 1000)], axis=-1).astype(float)


def fall_p_values(baseline, run):
    """P-values of the falls in F1, of TP, FP, FN, TN (U, R, 4)."""
    sums = [np.stack([2 * c[..., 0], 2 * c[..., 0] + c[..., 1] + c[..., 2]], axis=-1) for c in (baseline, run)]
    return swap_test(*sums, np.ones(baseline.shape[1])).p


def p_of_every_swap(baseline, run):
    """The same p from all 2^U swaps, F1 by its definition."""

    def f1(side):
        return np.array([2 * tp / (2 * tp + fp + fn) for tp, fp, fn, _ in side.sum(axis=0)])

    falls = []
    for swap in product((False, True), repeat=len(baseline)):
        chosen = np.array(swap)[:, None, None]
        falls.append(f1(np.where(chosen, run, baseline)) - f1(np.where(chosen, baseline, run)))
    standardised = np.array(falls) / np.std(falls, axis=0)
    return np.array([(standardised.max(axis=1) >= t - 1e-9).mean() for t in standardised[0]])


def test_random_permutations_agree_with_the_enumeration():
    rng = np.random.default_rng(5)
    baseline, run = counts(rng, 8, 3, 0.6), counts(rng, 8, 3, 0.57)
    np.testing.assert_allclose(fall_p_values(baseline, run), p_of_every_swap(baseline, run), atol=0.02)


def test_equal_counts_and_rows_without_occupied_cells_have_p_1():
    same = counts(np.random.default_rng(0), 20, 4, 0.5)
    same[:, 1, :3] = 0
    assert fall_p_values(same, same).tolist() == [1.0] * 4


def test_a_fall_in_every_unit_is_significant_in_its_row_and_a_rise_is_not():
    rng = np.random.default_rng(0)
    baseline = counts(rng, 20, 2, 0.5)
    run = baseline.copy()
    run[:, 0, 0] -= 5
    run[:, 0, 2] += 5
    run[:, 1, 0] += 5
    run[:, 1, 2] -= 5
    fell, rose = fall_p_values(baseline, run)
    assert fell < 0.001
    assert rose > 0.9


def test_of_a_score_that_is_better_when_it_is_lower_the_rise_is_significant():
    rng = np.random.default_rng(0)
    then = rng.uniform(1, 2, (20, 2, 2))
    now = then.copy()
    now[..., 0] *= [1.2, 0.8]
    rose, fell = swap_test(then, now, -np.ones(2)).p
    assert rose < 0.001
    assert fell > 0.9


def test_the_same_runs_get_the_same_p():
    rng = np.random.default_rng(1)
    baseline, run = counts(rng, 20, 3, 0.5), counts(rng, 20, 3, 0.5)
    assert fall_p_values(baseline, run).tolist() == fall_p_values(baseline, run).tolist()


def test_f1_is_the_harmonic_mean_of_precision_and_recall_and_undefined_where_nothing_was_occupied():
    f1 = f1_score(np.array([[6, 2, 4, 88], [0, 3, 0, 97]], float))
    assert f1[0] == pytest.approx(2 / (1 / (6 / 8) + 1 / (6 / 10)))
    assert np.isnan(f1[1])
