"""The energy score: by hand, against its definition in loops, and for any number of futures."""

import math
from itertools import permutations

import numpy as np
import pytest

from gridtrack.evaluation.referee.strata import STRATA_WITH_TRUTH
from gridtrack.evaluation.referee.targets import HIDDEN_OCCUPIED, NOT_SCORED, SEEN_FREE, SEEN_OCCUPIED, Target
from gridtrack.evaluation.scores.energy import ENERGY, ENERGY_STRATA, distance_and_spread

from scenes.scored_cells import counted, frame, region_maps, scored

SHAPE = (6, 6)


def target(state, part):
    return Target(frame(state < 2, state == SEEN_OCCUPIED), state, part)


def energy_sums(futures, targets, kinds):
    """Forecasts, distance and spread (S, K, 3)."""
    occupancy, maps = np.zeros((len(targets), *SHAPE), np.float32), region_maps(kinds, STRATA_WITH_TRUTH)
    strata, sums = counted(ENERGY, scored(occupancy, targets, maps, futures=futures))
    assert strata == ENERGY_STRATA
    return sums.values


def terms_of(futures, came):
    """Distance and spread of futures (F, N) against the observation (N,)."""
    vectors = np.vstack([futures, came])
    return distance_and_spread(vectors @ vectors.T, len(came))


def in_loops(futures, came):
    """The fair energy score of equation 22 by Gneiting and Raftery, by its definition: futures (F, N), came (N,)."""

    def distance(one, other):
        return math.sqrt(sum((a - b) ** 2 for a, b in zip(one, other, strict=True)) / len(one))

    pairs = list(permutations(futures.tolist(), 2))
    from_came = sum(distance(one, came.tolist()) for one in futures.tolist()) / len(futures)
    return from_came, sum(distance(*pair) for pair in pairs) / len(pairs) / 2


def test_two_futures_of_one_cell_by_hand():
    distance, spread = terms_of(np.array([[0.0], [1.0]]), np.array([1.0]))
    assert (distance, spread) == (0.5, 0.5)
    assert terms_of(np.ones((3, 4)), np.zeros(4)) == (1.0, 0.0)


@pytest.mark.parametrize("dtype", [np.bool_, np.float16])
def test_terms_agree_with_the_definition_in_loops(dtype):
    rng = np.random.default_rng(0)
    futures = rng.random((5, 3, *SHAPE))
    futures = futures < 0.4 if dtype == np.bool_ else futures.astype(np.float16)
    kinds, targets = rng.integers(0, 3, SHAPE).astype(np.uint8), []
    for _ in range(3):
        state = rng.choice([SEEN_FREE, SEEN_OCCUPIED, HIDDEN_OCCUPIED, NOT_SCORED], SHAPE).astype(np.uint8)
        targets.append(target(state, np.where(kinds == 2, rng.integers(0, 3, SHAPE), 0).astype(np.uint8)))
    found = energy_sums(futures, targets, kinds)
    for n, one in enumerate(targets):
        visible, dynamic = one.state <= SEEN_OCCUPIED, kinds == 2
        strata = {"visible": visible, "dynamic": visible & dynamic, "in-motion": visible & dynamic & (one.motion != 1)}
        for k, name in enumerate(ENERGY_STRATA):
            own = futures[:, n, strata[name]].astype(float)
            expected = in_loops(own, (one.state[strata[name]] == SEEN_OCCUPIED).astype(float))
            assert found[n, k].tolist() == pytest.approx([1, *expected])


def test_a_stratum_without_cells_has_no_score():
    unseen = target(np.full(SHAPE, NOT_SCORED, np.uint8), np.zeros(SHAPE, np.uint8))
    futures = np.zeros((2, 1, *SHAPE), bool)
    assert not energy_sums(futures, [unseen], np.full(SHAPE, 2, np.uint8)).any()


def test_the_expected_score_does_not_depend_on_the_number_of_futures():
    """Of two cells that are both occupied, or none of them."""

    def drawn(rng, count):
        return np.repeat(rng.random((count, 1)) < 0.5, 2, axis=1).astype(float)

    def mean_score(count):
        rng = np.random.default_rng(1)
        terms = [terms_of(drawn(rng, count), drawn(rng, 1)[0]) for _ in range(4000)]
        return np.subtract(*np.mean(terms, axis=0))

    assert mean_score(2) == pytest.approx(mean_score(32), abs=0.02)
