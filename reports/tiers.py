"""Tiers of a ranking: groups of rows of which no two are told apart."""

from __future__ import annotations

from collections.abc import Sequence

from gridtrack.evaluation.runs.summary import PairFamily

TOLD_APART = ("better", "worse")


def tiers_of(family: PairFamily) -> tuple[tuple[str, ...], ...]:
    """Groups of labels: two rows are told apart exactly where no group has both, among the tested pairs of `family`.

    Groups are grown one after another, each from the first pair that no group has yet: a cover of the pairs that are
    not told apart by sets in which all pairs are not (Piepho, J. Comp. Graph. Stat. 13, 2004, draws such groups as
    letters). A row that is told apart from all others is in none.
    """
    labels = list(dict.fromkeys(label for test in family.pairs for label in (test.tracker, test.other)))
    alike = {frozenset((test.tracker, test.other)) for test in family.pairs if test.verdict not in TOLD_APART}
    left, groups = dict.fromkeys(alike_in_order(labels, alike)), []
    while left:
        group = _grown(next(iter(left)), labels, alike)
        groups.append(tuple(label for label in labels if label in group))
        left = {pair: None for pair in left if not set(pair) <= set(group)}
    return tuple(groups)


def alike_in_order(labels: Sequence[str], alike: set[frozenset[str]]) -> list[tuple[str, str]]:
    """The pairs that are not told apart, in the order of `labels`."""
    pairs = ((one, other) for i, one in enumerate(labels) for other in labels[i + 1 :])
    return [pair for pair in pairs if frozenset(pair) in alike]


def _grown(pair: tuple[str, str], labels: Sequence[str], alike: set[frozenset[str]]) -> list[str]:
    """`pair` and every further row that is not told apart from any row of the group."""
    group = list(pair)
    for label in labels:
        if label not in group and all(frozenset((label, member)) in alike for member in group):
            group.append(label)
    return group
