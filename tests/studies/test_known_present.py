"""Forecasters that know the whole present, but not the future."""

from __future__ import annotations

import pytest

from gridtrack.evaluation.referee.splits import Sampling, plan_split
from gridtrack.evaluation.runs.oracle import Oracle
from gridtrack.evaluation.scores.f1 import f1_of

from scenes import drive
from studies.known_present import FORECASTERS, MOVES_ON, STANDS, confusion_of
from studies.support.unseen_places import HORIZONS_S, REFERENCE, STRATA

MOTION, VISIBLE = (list(STRATA).index(name) for name in ("in-motion", "visible"))


@pytest.fixture(scope="module")
def f1(tmp_path_factory):
    """F1 (H, K) of each forecaster and of the oracle, in a drive past people who walk to and fro."""
    path = drive.write_recording(tmp_path_factory.mktemp("drive") / "d.mcap", 12)
    split = plan_split(str(path), None, Sampling(max(HORIZONS_S), every_s=1.0))
    forecasters = FORECASTERS | {"oracle": lambda stream, steps: Oracle(stream)}
    return {name: f1_of(confusion_of(forecaster, split)) for name, forecaster in forecasters.items()}


def test_with_the_velocities_of_bodies_forecasts_are_near_the_oracle_except_where_bodies_reverse(f1):
    assert f1[MOVES_ON][:, VISIBLE] == pytest.approx(f1["oracle"][:, VISIBLE], abs=0.02)
    assert f1[MOVES_ON][0, MOTION] == pytest.approx(f1["oracle"][0, MOTION], abs=0.1)
    assert (f1[MOVES_ON][:, MOTION] < f1["oracle"][:, MOTION]).all()


def test_a_standing_scene_gets_bodies_wrong_that_move_far_and_standing_cells_right(f1):
    assert (f1[STANDS][1:, MOTION] < f1[MOVES_ON][1:, MOTION] / 2).all()
    assert (f1[STANDS][:, VISIBLE] > f1[REFERENCE][:, VISIBLE]).all()
