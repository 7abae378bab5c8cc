"""Drivers give way to people who walk, and after a cycle and a half no longer to those who only stand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gridtrack.simulation import junction
from gridtrack.simulation.junction import JUNCTION_SET, MARGIN_S, layout, patience
from gridtrack.simulation.junction.patience import FROM_S, PATIENCE_S, Patience
from gridtrack.simulation.sumo import Movements, run_sumo

pytest.importorskip("traci", reason="SUMO is not installed")

CORNER, OTHER_CORNER, MIDDLE = (4.1, 8.2), (-5.0, -6.0), (2.0, 6.5)
HERE = Path(junction.__file__).parent
SNAIL = """
<routes>
 <vType id="snail" vClass="pedestrian" length="0.3" width="0.5" desiredMaxSpeed="0.03" speedFactor="1"/>
 <vType id="car" vClass="passenger" length="4.5" width="1.8"/>
 <person id="snail" type="snail" depart="0" departPos="90"><walk from="NC" to="CN" arrivalPos="0"/></person>
 <flow id="car" type="car" begin="0" end="200" period="60" from="NC" to="CS" departLane="best"/>
</routes>
"""
"""Whoever crosses at 3 cm a second keeps the northern arm from two greens."""


class Traffic:
    """What Patience sees of SUMO, from a script: at each look the vehicles' waiting times and where people are."""

    def __init__(self, time_s: float = FROM_S) -> None:
        self.junction, self.vehicle, self.simulation = self, self, self
        self.time_s = time_s
        self.told: dict[str, dict[int, Any]] = {}
        self.ignored: dict[str, str] = {}
        self.patience = Patience("C")
        self.patience.begin(self)

    def subscribeContext(self, *about: object) -> None:
        pass

    def getContextSubscriptionResults(self, junction: str) -> dict[str, dict[int, Any]]:
        return self.told

    def getTime(self) -> float:
        return self.time_s

    def setParameter(self, vehicle: str, key: str, value: str) -> None:
        assert key == "junctionModel.ignoreIDs"
        self.ignored[vehicle] = value

    def look(self, waited_s: dict[str, float], people: dict[str, tuple[float, float]]) -> dict[str, str]:
        """What the vehicles were told at this look."""
        from traci import constants

        self.told = {name: {constants.VAR_WAITING_TIME: value} for name, value in waited_s.items()}
        self.told |= {name: {constants.VAR_POSITION: value} for name, value in people.items()}
        self.ignored = {}
        self.patience.look(self)
        return self.ignored


def test_ordinary_traffic_is_left_alone() -> None:
    traffic = Traffic()
    for waited_s in np.arange(0.0, PATIENCE_S + 1.0, 4.0):
        assert traffic.look({"car": float(waited_s)}, {"anna": CORNER}) == {}


def test_the_short_recordings_that_ship_are_over_before_patience_begins() -> None:
    ends_s = [start_s + minutes * 60.0 for name, (minutes, _, start_s) in JUNCTION_SET.items() if name[:4] == "test"]
    assert max(ends_s) + MARGIN_S <= FROM_S
    traffic = Traffic(FROM_S - 4.0)
    traffic.look({"car": 396.0}, {"anna": CORNER})
    assert traffic.look({"car": 400.0}, {"anna": CORNER}) == {}


def test_drivers_go_who_have_waited_a_cycle_and_a_half_but_not_before_people_who_walk_or_stand_in_their_way() -> None:
    traffic = Traffic()
    traffic.look({"car": 156.0}, {"anna": CORNER, "ben": OTHER_CORNER, "carl": MIDDLE})
    walked = (OTHER_CORNER[0] + 1.5, OTHER_CORNER[1])
    told = traffic.look({"car": 160.0, "bus": 3.0}, {"anna": CORNER, "ben": walked, "carl": MIDDLE, "dora": CORNER})
    assert told == {"car": "anna", "bus": "anna"}


def test_patience_lasts_while_who_stood_there_stands_and_then_comes_back() -> None:
    traffic = Traffic()
    traffic.look({"car": 156.0}, {"anna": CORNER})
    assert traffic.look({"car": 160.0}, {"anna": CORNER, "ben": OTHER_CORNER}) == {"car": "anna"}
    assert traffic.look({"bus": 0.0}, {"anna": CORNER, "ben": OTHER_CORNER}) == {"bus": "anna ben"}
    assert traffic.look({"bus": 4.0}, {"ben": OTHER_CORNER}) == {"bus": ""}
    assert traffic.look({"bus": 8.0}, {"ben": OTHER_CORNER}) == {}


def longest_wait_s(movements: Movements) -> float:
    """Of the cars at the stop line or in the queue behind it."""
    found = 0
    for user, kind in enumerate(movements.kind):
        if kind == "car":
            moved = np.abs(np.diff(movements.position[movements.user == user, 1])) > 0.01
            stops = np.flatnonzero(np.concatenate([[True], moved, [True]]))
            found = max(found, int(np.diff(stops).max()))
    return found * 0.125


def test_sumo_s_drivers_do_as_they_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("sumo", reason="SUMO is not installed")
    monkeypatch.setattr(patience, "CORNER_M", 0.0)  # the snail stands in the way
    monkeypatch.setattr(patience, "FROM_S", 0.0)
    waits = []
    for limit_s in (60.0, 1000.0):
        monkeypatch.setattr(patience, "PATIENCE_S", limit_s)
        folder = tmp_path / str(limit_s)
        folder.mkdir()
        signals = (HERE / "signals.add.xml",)
        movements = run_sumo(
            folder, HERE / "network.net.xml", SNAIL, signals, (0.0, 420.0), 1, Patience(layout.JUNCTION_NODE)
        )
        waits.append(longest_wait_s(movements))
    assert waits[0] <= 60.0 + layout.CYCLE_S
    assert waits[1] > 240.0
