"""The search of settings: the score that it compares, and settings that are pruned because they are clearly worse."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from gridtrack.trackers.contract import StretchScore
from gridtrack.trackers.training.excerpts import SELECTION_STRATA, mean_of_defined, selection_scores
from gridtrack.trackers.training.searched_fit import FEWEST_EXCERPTS, _scored, _study

SOURCE = SimpleNamespace(period_s=0.1)
EXCERPTS = 24
NOTHING = np.full(30, np.nan)
RANDOM = np.random.default_rng(5)
DIFFICULTY = RANDOM.uniform(0.1, 0.9, EXCERPTS)


def selected_by(contacts=NOTHING, **f1):
    """The score by which settings are selected, from curves of contacts foreseen and of F1."""
    of_strata = {name: f1.get(name.replace("-", "_"), NOTHING) for name in SELECTION_STRATA}
    return mean_of_defined(selection_scores(StretchScore(of_strata, {}, contacts), SOURCE).values())


def test_an_excerpt_is_compared_by_the_mean_of_the_scores_that_are_defined():
    visible = np.linspace(0.9, 0.5, 30)
    assert selected_by(visible=visible) == pytest.approx(visible[[5, 10, 20]].mean())
    assert np.isnan(selected_by())
    values = {"visible": 0.8, "dynamic": 0.5, "in_motion": 0.2, "contacts": 0.9}
    curves = {name: np.full(30, value) for name, value in values.items()}
    assert selected_by(**curves) == pytest.approx(0.6), "F1 of three strata and contacts foreseen count alike"


def scores_of(offset):
    """Scores that differ between excerpts by 0.2, and from other settings by `offset` and 0.01."""
    return list(DIFFICULTY + offset + RANDOM.normal(0.0, 0.01, EXCERPTS))


def searched(*tries):
    """How many excerpts were scored, and the mean score, of settings that are tried one after the other."""
    study, found = _study({}, seed=0), []
    for scores in tries:
        trial = study.ask()
        scored, mean = _scored(trial, iter(scores))
        study.tell(trial, mean)
        found.append((len(scored), mean))
    return found


def test_settings_that_are_clearly_worse_are_pruned_and_their_mean_is_estimated():
    worse = scores_of(-0.1)
    whole, (count, mean) = searched(list(DIFFICULTY), worse)
    assert whole == (EXCERPTS, pytest.approx(DIFFICULTY.mean()))
    assert FEWEST_EXCERPTS <= count < EXCERPTS
    assert mean == pytest.approx(np.mean(worse), abs=0.02)
    # the mean of the excerpts that were run says nothing: they may be the easy ones
    assert abs(np.mean(worse[:count]) - np.mean(worse)) > abs(mean - np.mean(worse))


def test_better_and_equal_settings_are_scored_on_every_excerpt_and_become_the_best():
    better = scores_of(0.05)
    _, second, third = searched(list(DIFFICULTY), better, list(DIFFICULTY))
    assert second == (EXCERPTS, pytest.approx(np.mean(better)))
    assert third[0] < EXCERPTS


def test_on_few_excerpts_nothing_is_pruned():
    few = FEWEST_EXCERPTS - 1
    assert searched([0.9] * few, [0.1] * few)[1] == (few, pytest.approx(0.1))


def test_excerpts_without_a_score_count_neither_way():
    best, worse = ([math.nan if n % 2 else value for n in range(EXCERPTS)] for value in (0.9, 0.5))
    whole, pruned = searched(best, worse)
    assert whole == (EXCERPTS, pytest.approx(0.9))
    assert pruned == (2 * FEWEST_EXCERPTS - 1, pytest.approx(0.5))
    assert math.isnan(_scored(_study({}, seed=0).ask(), [math.nan])[1])


def test_an_interrupted_search_prunes_as_it_would_have():
    tries = [scores_of(offset) for offset in (0.0, -0.05, 0.02, -0.01, 0.03, -0.2)]
    expected = searched(*tries)
    kept = [scores[:count] for scores, (count, _) in zip(tries[:3], expected, strict=False)]
    assert searched(*kept, *tries[3:]) == expected
