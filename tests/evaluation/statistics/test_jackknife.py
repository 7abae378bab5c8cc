"""Intervals and paired differences agree with independent computations, and are not drawn from too little."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from sklearn.metrics import average_precision_score

from gridtrack.evaluation.scores.cells import PROBABILITY_BINS, PROBABILITY_EDGES
from gridtrack.evaluation.scores.definition import Ratio, Sums, block
from gridtrack.evaluation.scores.pr_auc import PR_AUC
from gridtrack.evaluation.statistics import jackknife
from gridtrack.evaluation.statistics.jackknife import (
    LEAST_UNITS,
    Replicates,
    difference,
    holm,
    ratio_replicates,
    replicates,
)

COUNTS = ("tp", "fp", "fn", "tn", "squared_error", "log_loss")
SCALES = {"f1": "odds", "brier": "odds", "log_loss": "log"}


def replicates_of(counts, score="f1"):
    """The replicates of a score of counts (U, ..., C) of units."""
    tp, fp, fn, tn, squared_error, loss = np.moveaxis(counts, -1, 0)
    cells = tp + fp + fn + tn
    ratios = {
        "f1": Ratio(2 * tp, 2 * tp + fp + fn, support=tp + fn, counted=True),
        "brier": Ratio(squared_error, cells),
        "log_loss": Ratio(loss, cells),
    }
    return ratio_replicates(ratios[score])


def interval(counts, score="f1"):
    return ends_of(replicates_of(counts, score), SCALES[score])


def ends_of(found, scale):
    estimate = jackknife.interval(found, scale)
    return estimate.low, estimate.high


def differences(own, other, score="f1"):
    return difference(replicates_of(own, score), replicates_of(other, score))


def ratio_interval(part, whole):
    return ends_of(ratio_replicates(Ratio(part, whole)), "log")


def proportion_interval(part, whole):
    return ends_of(ratio_replicates(Ratio(part, whole)), "odds")


def pr_auc_of(cells, positives):
    """The replicates of PR-AUC of histograms (U, ..., B) of units."""
    parts = (*block("cells", PROBABILITY_BINS), *block("occupied", PROBABILITY_BINS))
    sums = Sums(np.concatenate([cells, positives], axis=-1).astype(float), parts)
    return replicates(PR_AUC.value, lambda: iter([sums]), Sums(sums.values.sum(axis=0), parts))["area"]


def counts_of(rng, units=20, recall=0.6, cells=200, shape=()):
    """Counts (units, *shape, C) of a tracker that finds each occupied cell with `recall`, units of unlike size."""
    positives = rng.poisson(cells * np.exp(0.4 * rng.standard_normal((units, *shape))))
    tp = rng.binomial(positives, np.clip(recall + 0.1 * rng.standard_normal((units, *shape)), 0, 1))
    fp = rng.poisson(0.3 * positives)
    tn = np.full_like(tp, 5000)
    loss = 0.3 * positives + rng.random((units, *shape))
    return np.stack([tp, fp, positives - tp, tn, 0.4 * loss, loss], axis=-1).astype(float)


def f1_by_hand(counts):
    tp, fp, fn = counts[..., 0].sum(0), counts[..., 1].sum(0), counts[..., 2].sum(0)
    return 2 * tp / (2 * tp + fp + fn)


def f1_sizes(counts):
    return 2 * counts[:, 0] + counts[:, 1] + counts[:, 2]


def jackknife_error(without):
    """The standard error from the values without each of twenty units."""
    return np.sqrt(19 / 20 * np.sum((without - np.mean(without)) ** 2))


def freedom_of(*sizes):
    """Degrees of freedom: the smallest effective number of units, less one."""
    return min(size.sum() ** 2 / (size**2).sum() for size in sizes) - 1


def test_the_interval_is_the_jackknife_of_the_log_odds_computed_one_unit_at_a_time():
    counts = counts_of(np.random.default_rng(1))
    kept = [np.delete(counts, unit, axis=0) for unit in range(20)]
    odds = [np.log(2 * k[:, 0].sum() + 0.5) - np.log(k[:, 1:3].sum() + 0.5) for k in kept]
    sums = (2 * counts[:, 0], counts[:, 1] + counts[:, 2])
    centre = np.log(sums[0].sum() / sums[1].sum())
    ends = centre + np.array([-1, 1]) * stats.t.ppf(0.975, freedom_of(*sums)) * jackknife_error(odds)
    assert np.array(interval(counts)) == pytest.approx(1 / (1 + np.exp(-ends)))


@pytest.mark.parametrize("score", SCALES)
def test_the_interval_is_near_the_bootstraps_where_units_are_many_and_alike(score):
    counts = counts_of(np.random.default_rng(2), units=200)
    bootstrap = stats.bootstrap(
        (np.arange(200),),
        lambda chosen: float(replicates_of(counts[chosen], score).value),
        vectorized=False,
        n_resamples=999,
        method="percentile",
        rng=0,
    ).confidence_interval
    width = bootstrap.high - bootstrap.low
    assert np.array(interval(counts, score)) == pytest.approx([bootstrap.low, bootstrap.high], abs=0.15 * width)


def test_few_units_that_agree_exactly_tell_nothing():
    own, other = np.zeros((2, 20, len(COUNTS)))
    own[:2, COUNTS.index("tp")] = other[:2, COUNTS.index("fn")] = 1.0
    found = differences(own, other)
    assert (float(found.value), np.isnan(found.low), np.isnan(found.p)) == (1.0, True, True)
    assert np.isnan(interval(own)).all()
    own[:, COUNTS.index("tp")] = other[:, COUNTS.index("fn")] = 1.0
    assert differences(own, other).low == 1.0, "twenty units that agree leave no doubt"
    assert np.array(interval(own)) == pytest.approx(np.ones(2))


def test_differences_within_rounding_are_none():
    own, other = (counts_of(np.random.default_rng(5)) for _ in "ab")
    other[:, COUNTS.index("log_loss")] *= 1 + 1e-12
    assert differences(own, other, "log_loss").p == 1.0


@pytest.mark.parametrize("interval_of", [ratio_interval, proportion_interval])
def test_the_interval_of_a_sum_that_is_no_count_does_not_depend_on_its_unit(interval_of):
    rng = np.random.default_rng(2)
    part, whole = 0.03 * rng.lognormal(0, 0.6, (20, 1)), np.full((20, 1), 20.0)
    expected = np.array(interval_of(part, whole))
    for unit in (1e-6, 1000.0):
        scaled = whole if interval_of is ratio_interval else whole * unit
        found = np.array(interval_of(part * unit, scaled))
        assert found / (unit if interval_of is ratio_interval else 1) == pytest.approx(expected)


def test_the_interval_of_a_loss_in_one_unit_is_wide_and_without_loss_it_is_a_point():
    part, whole = np.zeros((20, 2)), np.full((20, 2), 20.0)
    part[3, 0] = 8.0
    low, high = ratio_interval(part, whole)
    assert low[0] < 1e-6
    assert 1e3 < high[0] < np.inf
    assert (low[1], high[1]) == (0.0, 0.0)


def test_the_interval_covers_the_truth_about_as_often_as_it_says():
    rng = np.random.default_rng(3)
    low, high = interval(counts_of(rng, shape=(2000,)))
    truth = f1_by_hand(counts_of(rng, units=100_000))
    assert np.mean((low <= truth) & (truth <= high)) == pytest.approx(0.95, abs=0.02)


def test_of_too_few_units_no_interval_and_no_p_value_is_drawn():
    counts = counts_of(np.random.default_rng(4), units=LEAST_UNITS - 1)
    assert np.isnan(interval(counts)).all()
    found = differences(counts, counts)
    assert (float(found.value), np.isnan([found.low, found.high, found.p]).all()) == (0.0, True)


def test_a_score_that_is_undefined_has_no_interval_and_one_of_nothing_but_zeros_is_a_point():
    counts = counts_of(np.random.default_rng(5), shape=(2,))
    counts[:, 0, [0, 2]] = 0.0
    counts[:, 1, [0, 1]] = 0.0
    low, high = interval(counts)
    assert np.isnan([low[0], high[0]]).all()
    assert (low[1], high[1]) == (0.0, 0.0)


def test_one_unit_that_holds_all_the_hits_says_little():
    counts = counts_of(np.random.default_rng(6))
    counts[1:, 0] = 0.0
    low, high = interval(counts)
    assert 0.0 <= low < 0.01
    assert high > 0.9


@pytest.mark.parametrize("side", [0.0, 1.0])
def test_a_rate_that_one_event_keeps_from_its_end_is_nearly_sure(side):
    """A thousand contacts in each of twenty recordings, all but one of 20,000 foreseen, or all but one missed."""
    size = np.full(20, 1000.0)
    events = size.sum()
    without = np.full(20, abs(side - 1 / (events - 1000)))
    without[7] = side
    found = Replicates(np.array(abs(side - 1 / events)), without, size)
    ends = np.abs(side - np.array(ends_of(found, "odds")))
    assert (ends > 0).all()
    assert (ends < 1e-3).all()
    sure = Replicates(np.array(side), np.full(20, side), size)
    assert ends_of(sure, "odds") == (side, side)


def test_the_same_counts_differ_by_exactly_nothing():
    counts = counts_of(np.random.default_rng(7), shape=(21, 8))
    found = differences(counts, counts.copy())
    assert not np.any([found.value, found.low, found.high])
    assert (found.p == 1.0).all()


def test_the_difference_is_the_jackknifes_computed_one_unit_at_a_time():
    rng = np.random.default_rng(8)
    one, other = counts_of(rng), counts_of(rng, recall=0.5)
    without = [f1_by_hand(np.delete(one, u, axis=0)) - f1_by_hand(np.delete(other, u, axis=0)) for u in range(20)]
    value, error = f1_by_hand(one) - f1_by_hand(other), jackknife_error(without)
    freedom = freedom_of(f1_sizes(one), f1_sizes(other))
    found = differences(one, other)
    assert float(found.value) == pytest.approx(value)
    assert float(found.p) == pytest.approx(2 * stats.t.sf(abs(value) / error, freedom))
    assert float(found.high - found.low) == pytest.approx(2 * stats.t.ppf(0.975, freedom) * error)


def test_a_difference_of_differences_is_the_jackknifes_computed_one_unit_at_a_time():
    sides = [counts_of(np.random.default_rng(seed), recall=recall) for seed, recall in enumerate((0.8, 0.5, 0.6, 0.5))]
    own, floor, other, others_floor = map(replicates_of, sides)
    found = difference(own.minus(floor), other.minus(others_floor))
    signs, f1 = (1, -1, -1, 1), [f1_by_hand(side) for side in sides]
    without = [np.dot(signs, [f1_by_hand(np.delete(side, unit, axis=0)) for side in sides]) for unit in range(20)]
    sizes = list(map(f1_sizes, sides))
    freedom = freedom_of(np.minimum(*sizes[:2]), np.minimum(*sizes[2:]))
    assert float(found.value) == pytest.approx(np.dot(signs, f1))
    assert float(found.high - found.low) == pytest.approx(2 * stats.t.ppf(0.975, freedom) * jackknife_error(without))


def test_units_of_different_number_are_not_paired():
    counts = counts_of(np.random.default_rng(10), units=21)
    with pytest.raises(ValueError, match="21 units cannot be paired with 20"):
        differences(counts, counts[1:])


def test_a_difference_there_is_not_is_found_as_seldom_as_it_should_be():
    rng = np.random.default_rng(11)
    shape = (2000,)
    p = differences(counts_of(rng, shape=shape), counts_of(rng, shape=shape)).p
    assert np.mean(p < 0.05) == pytest.approx(0.05, abs=0.015)


def test_holms_correction_by_hand():
    # Holm 1979: 0.01 x 4, 0.02 x 3, 0.03 x 2, 0.04 x 1, and never less than the one before
    assert holm(np.array([0.04, 0.01, 0.03, 0.02])) == pytest.approx([0.06, 0.04, 0.06, 0.06])
    assert holm(np.array([0.9, 0.6])) == pytest.approx([1.0, 1.0])


def test_a_comparison_that_could_not_be_made_is_none_of_the_family():
    adjusted = holm(np.array([np.nan, 0.02, 0.01]))
    assert np.isnan(adjusted[0])
    assert adjusted[1:] == pytest.approx([0.02, 0.02])


def histograms(rng, units=20, skill=2.0):
    """Cells and positives (units, 1, B) of units of unlike size and difficulty; `skill` parts occupied from free."""
    shape = (units, 1, PROBABILITY_BINS)
    cells, positives = np.zeros((2, *shape), np.int64)
    for u in range(units):
        occupied = rng.poisson(60 * np.exp(0.5 * rng.standard_normal()))
        score = np.concatenate([rng.normal(skill + 0.4 * rng.standard_normal(), 1, occupied), rng.normal(0, 1, 3000)])
        bins = PROBABILITY_EDGES[1:-1].searchsorted(1 / (1 + np.exp(4 - score)), side="right")
        cells[u, 0] = np.bincount(bins, minlength=PROBABILITY_BINS)
        positives[u, 0] = np.bincount(bins[:occupied], minlength=PROBABILITY_BINS)
    return cells, positives


def area_by_hand(cells, positives):
    """PR-AUC of pooled histograms (units, 1, B), by scikit-learn cell by cell."""
    bins = np.arange(PROBABILITY_BINS)
    hits, all_cells = positives.sum(axis=(0, 1)), cells.sum(axis=(0, 1))
    truth = np.repeat([True, False], [hits.sum(), (all_cells - hits).sum()])
    return average_precision_score(truth, np.concatenate([np.repeat(bins, hits), np.repeat(bins, all_cells - hits)]))


def test_the_interval_of_pr_auc_is_the_jackknife_of_its_log_odds_computed_one_unit_at_a_time():
    cells, positives = histograms(np.random.default_rng(5))
    without = np.array([area_by_hand(*(np.delete(one, u, axis=0) for one in (cells, positives))) for u in range(20)])
    sizes, value = positives.sum(axis=(1, 2)), area_by_hand(cells, positives)
    kept = sizes.sum() - sizes
    odds = np.log(without * kept + 0.5) - np.log((1 - without) * kept + 0.5)
    reach = stats.t.ppf(0.975, freedom_of(sizes)) * jackknife_error(odds)
    ends = 1 / (1 + np.exp(-(np.log(value / (1 - value)) + np.array([-1, 1]) * reach)))
    found = pr_auc_of(cells, positives)
    assert found.value == pytest.approx(value)
    assert np.ravel(ends_of(found, "odds")) == pytest.approx(ends)


def test_a_pr_auc_that_is_undefined_without_a_unit_has_no_interval():
    cells, positives = histograms(np.random.default_rng(7))
    positives[1:] = 0
    found = pr_auc_of(cells, positives)
    assert np.isfinite(found.value).all()
    assert np.isnan(ends_of(found, "odds")).all()


def test_units_in_groups_have_the_replicates_of_all_together():
    cells, positives = histograms(np.random.default_rng(8))
    parts = (*block("cells", PROBABILITY_BINS), *block("occupied", PROBABILITY_BINS))
    values = np.concatenate([cells, positives], axis=-1).astype(float)
    total = Sums(values.sum(axis=0), parts)
    groups = [Sums(values[first : first + 7], parts) for first in range(0, 20, 7)]
    found, expected = replicates(PR_AUC.value, lambda: iter(groups), total)["area"], pr_auc_of(cells, positives)
    assert np.array_equal(found.without, expected.without)
    assert np.array_equal(found.size, expected.size)


def test_a_measure_that_is_zero_without_some_unit_has_no_interval_on_a_logarithmic_scale():
    without = np.stack([np.full(20, 0.5), np.where(np.arange(20) == 3, 0.0, 0.5), np.zeros(20)], axis=1)
    found = Replicates(np.array([0.5, 0.5, 0.0]), without, np.ones((20, 3)))
    with np.errstate(all="raise"):
        low, high = ends_of(found, "log")
    assert (low[0], high[0]) == (0.5, 0.5)
    assert np.isnan([*low[1:], *high[1:]]).all()
