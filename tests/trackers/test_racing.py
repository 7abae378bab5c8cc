"""The race between settings: losers are cut short, and their mean is estimated from the excerpts that they ran."""

import math

import numpy as np
import pytest

from gridtrack.trackers.racing import FEWEST_EXCERPTS, Race

EXCERPTS = 24
RANDOM = np.random.default_rng(5)
DIFFICULTY = RANDOM.uniform(0.1, 0.9, EXCERPTS)


def scores_of(offset: float) -> list[float]:
    """Scores that differ between excerpts by 0.2, and from other settings by `offset` and 0.01."""
    return list(DIFFICULTY + offset + RANDOM.normal(0.0, 0.01, EXCERPTS))


def raced(race: Race, scores: list[float]) -> tuple[int, float]:
    scored = race.run(iter(scores))
    return len(scored), race.mean(scored)


def test_settings_that_are_clearly_worse_stop_early_and_their_mean_is_estimated():
    race, worse = Race(), scores_of(-0.1)
    assert raced(race, list(DIFFICULTY)) == (EXCERPTS, pytest.approx(DIFFICULTY.mean()))
    count, mean = raced(race, worse)
    assert FEWEST_EXCERPTS <= count < EXCERPTS
    assert mean == pytest.approx(np.mean(worse), abs=0.02)
    # the mean of the excerpts that were run says nothing: they may be the easy ones
    assert abs(np.mean(worse[:count]) - np.mean(worse)) > abs(mean - np.mean(worse))


def test_better_and_equal_settings_are_scored_on_every_excerpt_and_become_the_best():
    race, better = Race(), scores_of(0.05)
    raced(race, list(DIFFICULTY))
    assert raced(race, better) == (EXCERPTS, pytest.approx(np.mean(better)))
    assert raced(race, list(DIFFICULTY))[0] < EXCERPTS


def test_a_race_over_fewer_excerpts_than_tell_settings_apart_is_a_plain_mean():
    race, few = Race(), FEWEST_EXCERPTS - 1
    raced(race, [0.9] * few)
    assert raced(race, [0.1] * few) == (few, pytest.approx(0.1))


def test_excerpts_without_a_score_count_neither_way():
    race = Race()
    best = [math.nan if n % 2 else 0.9 for n in range(EXCERPTS)]
    assert raced(race, best) == (EXCERPTS, pytest.approx(0.9))
    worse = [math.nan if n % 2 else 0.5 for n in range(EXCERPTS)]
    count, mean = raced(race, worse)
    assert count == 2 * FEWEST_EXCERPTS - 1
    assert mean == pytest.approx(0.5)
    assert math.isnan(Race().mean([math.nan]))


def test_an_interrupted_race_goes_on_as_it_would_have():
    tries = [scores_of(offset) for offset in (0.0, -0.05, 0.02, -0.01, 0.03, -0.2)]
    whole = Race()
    expected = [raced(whole, scores) for scores in tries]
    first, resumed, written = Race(), Race(), []
    for scores in tries[:3]:
        written.append(first.run(iter(scores)))
        first.mean(written[-1])
    again = [(len(scored), resumed.mean(scored)) for scored in written]
    assert again + [raced(resumed, scores) for scores in tries[3:]] == expected
