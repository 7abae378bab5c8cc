"""How often at least one of many families of tests has a difference between equal trackers."""

import numpy as np
import pytest

from gridtrack.evaluation.scores.definition import Ratio
from gridtrack.evaluation.statistics.jackknife import ratio_replicates
from gridtrack.evaluation.statistics.wild_bootstrap import false_difference_rate

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
