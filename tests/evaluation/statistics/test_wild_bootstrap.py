"""Many differences over the same units, together."""

import numpy as np
import pytest

from gridtrack.evaluation.scores.definition import Ratio
from gridtrack.evaluation.statistics.jackknife import degrees_of_freedom, difference, ratio_replicates
from gridtrack.evaluation.statistics.wild_bootstrap import (
    Variation,
    false_difference_rate,
    family_p,
    influence_on_difference,
)

UNITS = 30
NAMES = "abcd"


def rows(rng, count=4):
    """Rows of shares of 1000 cells in each unit, of one mean."""
    whole = np.full(UNITS, 1000.0)
    return {
        name: ratio_replicates(Ratio(rng.binomial(1000, 0.6, UNITS).astype(float), whole)) for name in NAMES[:count]
    }


@pytest.fixture
def rng():
    return np.random.default_rng(5)


def test_one_family_has_one_in_at_most_about_a_twentieth(rng):
    assert false_difference_rate([rows(rng, 2)]) == pytest.approx(0.05, abs=0.02)
    assert 0.01 < false_difference_rate([rows(rng)]) < 0.07


def test_families_that_agree_are_as_one(rng):
    one = rows(rng)
    assert false_difference_rate([one] * 9) == false_difference_rate([one])


def test_independent_families_add_up(rng):
    """Nine tests at a level of 5 %: 1 - 0.95^9 = 37 %."""
    assert false_difference_rate([rows(rng, 2) for _ in range(9)]) == pytest.approx(1 - 0.95**9, abs=0.06)


def test_a_true_difference_does_not_count(rng):
    better = ratio_replicates(Ratio(rng.binomial(1000, 0.9, UNITS).astype(float), np.full(UNITS, 1000.0)))
    assert false_difference_rate([rows(rng, 1) | {"z": better}]) == pytest.approx(0.05, abs=0.02)


def test_rows_with_equal_sums_do_not_differ(rng):
    (one,) = rows(rng, 1).values()
    assert false_difference_rate([{"a": one, "b": one}]) == 0.0


def falls(rng, rows, independent=True, fall=0.0):
    """The one-sided p-values of falls of N rows without a change, and the variation of the rows."""
    whole = np.full(UNITS, 1000.0)
    hits = rng.binomial(1000, 0.6, (2, UNITS, rows if independent else 1)).astype(float)
    own, base = (np.broadcast_to(side, (UNITS, rows)) for side in (hits[0] * (1 - fall), hits[1]))
    pairs = [[ratio_replicates(Ratio(side[:, n], whole)) for side in (own, base)] for n in range(rows)]
    found = [difference(*pair) for pair in pairs]
    p = np.array([float(one.p) / 2 if one.value < 0 else 1 - float(one.p) / 2 for one in found])
    freedom = np.array([degrees_of_freedom(one.size, other.size) for one, other in pairs])
    influence = np.stack([influence_on_difference(*pair) for pair in pairs], axis=1)
    return p, Variation(influence, freedom, np.zeros(rows))


def test_rows_that_agree_are_corrected_as_one(rng):
    p, variation = falls(rng, 30, independent=False, fall=0.02)
    corrected, level = family_p(p, variation)
    assert corrected == pytest.approx(p, abs=0.02)
    assert level == pytest.approx(0.05, abs=0.015)


def test_independent_rows_are_corrected_as_by_holm(rng):
    corrected, level = family_p(*falls(rng, 10))
    assert level == pytest.approx(0.05 / 10, abs=0.003)
    assert (corrected >= 0.05).all()


def test_a_family_without_a_change_has_a_fall_in_one_run_of_twenty(rng):
    runs = [family_p(*falls(rng, 6))[0].min() < 0.05 for _ in range(300)]
    assert np.mean(runs) == pytest.approx(0.05, abs=0.035)


def test_a_row_without_a_result_is_not_part_of_the_family(rng):
    p, variation = falls(rng, 2, fall=0.02)
    alone = family_p(np.array([p[0], np.nan]), variation)[0]
    assert np.isnan(alone[1])
    assert alone[0] <= family_p(p, variation)[0][0]


def test_rows_that_never_vary_do_not_count(rng):
    p, variation = falls(rng, 1, fall=0.02)
    constant = np.concatenate([variation.influence, np.zeros((UNITS, 40))], axis=1)
    wide = Variation(constant, np.repeat(variation.freedom, 41), np.zeros(41))
    assert family_p(np.array([*p, *np.ones(40)]), wide)[0][0] == family_p(p, variation)[0][0]


def test_the_variance_between_trainings_makes_a_fall_likelier_by_chance(rng):
    p, variation = falls(rng, 5)
    trained = Variation(variation.influence, variation.freedom, np.full(5, 0.02), 3.5)
    corrected, level = family_p(p, trained)
    assert 0.002 < level < 0.05
    assert not np.isnan(corrected).any()
