"""Two rows are told apart exactly where no tier has both."""

from itertools import combinations

from hypothesis import given
from hypothesis import strategies as st

from gridtrack.evaluation.runs.summary import PairFamily, PairTest
from gridtrack.reports.tiers import tiers_of


def family(labels, told_apart):
    pairs = tuple(
        PairTest(tracker=one, other=other, verdict="better" if (one, other) in told_apart else "no difference shown")
        for one, other in combinations(labels, 2)
    )
    return PairFamily(recordings="r", score="f1", stratum="in-motion", horizon_s=1.0, step=8, units=20, pairs=pairs)


def test_a_chain_makes_two_tiers_that_overlap():
    assert tiers_of(family("abc", {("a", "c")})) == (("a", "b"), ("b", "c"))


def test_a_row_told_apart_from_all_is_in_no_tier():
    assert tiers_of(family("abc", {("a", "b"), ("a", "c")})) == (("b", "c"),)


@given(st.sets(st.sampled_from(list(combinations("abcdef", 2)))))
def test_two_rows_share_a_tier_exactly_where_they_are_not_told_apart(told_apart):
    tiers = tiers_of(family("abcdef", told_apart))
    for pair in combinations("abcdef", 2):
        assert any(set(pair) <= set(tier) for tier in tiers) == (pair not in told_apart)
