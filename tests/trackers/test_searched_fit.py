"""The score by which a search compares settings."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from gridtrack.trackers.contract import StretchScore
from gridtrack.trackers.training.excerpts import SELECTION_STRATA
from gridtrack.trackers.training.searched_fit import selection_f1

SOURCE = SimpleNamespace(period_s=0.1)


def score(**f1):
    return StretchScore({name: f1.get(name.replace("-", "_"), np.full(30, np.nan)) for name in SELECTION_STRATA}, {})


def test_an_excerpt_in_which_nothing_moves_is_compared_by_what_is_defined():
    visible = np.linspace(0.9, 0.5, 30)
    assert selection_f1(score(visible=visible), SOURCE) == pytest.approx(visible[[5, 10, 20]].mean())
    assert np.isnan(selection_f1(score(), SOURCE))


def test_an_excerpt_in_which_all_is_defined_is_the_mean_of_all():
    values = {"visible": 0.8, "dynamic": 0.5, "in_motion": 0.2}
    found = score(**{name: np.full(30, value) for name, value in values.items()})
    assert selection_f1(found, SOURCE) == pytest.approx(0.5)
