"""The floors of a comparison: added unless they are named or refused, and said where one cannot run."""

from __future__ import annotations

import pytest

from gridtrack.common.errors import PluginError
from gridtrack.evaluation.runs.learned import find_weights
from gridtrack.evaluation.runs.plan import resolve
from gridtrack.trackers import registry

SOURCE = """
import numpy as np
from gridtrack.trackers.contract import Forecast, Tracker

class Drift(Tracker):
    role = "floor"
    def reset(self, seed): pass
    def update(self, frame): pass
    def predict(self, steps): return Forecast(np.zeros((steps + 1, *self.stream.grid.shape), np.float32))

class Fast(Drift):
    role = "tracker"
"""


@pytest.fixture
def rows(settings):
    """`rows(*trackers, **settings)`: the card that each row of the comparison may use, by label."""

    def rows(*trackers, **more):
        plan = resolve(settings(*trackers, **({"no_floors": False} | more)))
        return {trial.label: trial.selection.card for trial in plan.trials}

    return rows


def test_floors_that_no_row_names_are_added_with_general_weights(rows):
    floors = registry.floors()
    assert {"persistence", "static-map", "blank", "stationary"} <= floors.keys()
    assert rows("kalman", "mine=blank") == {"kalman": "any", "mine": "any"} | dict.fromkeys(
        (name for name in floors if name != "blank"), "general"
    )
    assert rows("kalman", no_floors=True) == {"kalman": "any"}


def test_every_tracker_has_the_floors_as_if_they_were_named_and_no_floor_if_refused(rows):
    live = registry.entries().keys() - registry.recorded().keys()
    live = {name for name in live if name in registry.floors() or find_weights(name, "room", None)}
    assert rows() == dict.fromkeys(live, "any")
    assert rows(no_floors=True).keys() == live - registry.floors().keys()


def test_a_floor_of_another_package_is_added_and_left_out_in_a_line_where_its_extra_is_missing(settings, rows, install):
    files, group = {"drift.py": SOURCE}, "gridtrack.floors"
    install("drift", {"drift": "drift:Drift"}, files, group=group)
    assert rows("blank")["drift"] == "general"
    needed = "Requires-Dist: no-such-library; extra == 'lost'"
    install("lost-floor", {"lost": "drift:Drift"}, requires=needed, group=group)
    plan = resolve(settings("blank", no_floors=False))
    assert "lost" not in {trial.label for trial in plan.trials}
    assert "lost: a floor that is left out: it needs pip install 'lost-floor[lost]'" in map(str, plan.notices)


def test_a_tracker_that_is_registered_as_a_floor_says_so_itself(install):
    install("fast", {"fast": "drift:Fast"}, {"drift.py": SOURCE}, group="gridtrack.floors")
    with pytest.raises(PluginError, match=r"registered in gridtrack\.floors, and its role is 'tracker': set role"):
        registry.load("fast")


def test_a_built_in_tracker_without_any_weights_is_a_row_only_if_it_is_named(settings, monkeypatch):
    monkeypatch.setattr("gridtrack.evaluation.runs.plan.find_weights", lambda name, *_: None)
    plan = resolve(settings())
    left_out = {notice.row for notice in plan.notices if "no weights of it are installed" in notice.text}
    assert {"kalman", "dilated-convgru", "conv-lstm"} <= left_out
    assert left_out.isdisjoint(trial.selection.label for trial in plan.trials)
    (trial,) = resolve(settings("conv-lstm")).trials
    assert trial.selection.name == "conv-lstm"
