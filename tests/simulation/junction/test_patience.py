"""After one and a half signal cycles drivers no longer give way to standing pedestrians."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gridtrack.simulation import junction
from gridtrack.simulation.junction import JUNCTION_SET, MARGIN_S, layout, road_users
from gridtrack.simulation.junction.road_users import FROM_S, PATIENCE_S, Patience
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
"""A pedestrian who crosses at 3 cm per second blocks the northern arm for two green phases."""


class Traffic:
    """A scripted TraCI connection: waiting times of vehicles and positions of pedestrians at each observation."""

    def __init__(self, time_s: float = FROM_S) -> None:
        self.junction, self.vehicle, self.simulation = self, self, self
        self.time_s = time_s
        self.values: dict[str, dict[int, Any]] = {}
        self.ignored: dict[str, str] = {}
        self.patience = Patience("C")
        self.patience.start(self)

    def subscribeContext(self, *about: object) -> None:
        pass

    def getContextSubscriptionResults(self, junction: str) -> dict[str, dict[int, Any]]:
        return self.values

    def getTime(self) -> float:
        return self.time_s

    def setParameter(self, vehicle: str, key: str, value: str) -> None:
        assert key == "junctionModel.ignoreIDs"
        self.ignored[vehicle] = value

    def observe(self, waited_s: dict[str, float], people: dict[str, tuple[float, float]]) -> dict[str, str]:
        """The parameters of vehicles that this observation sets."""
        from traci import constants

        self.values = {name: {constants.VAR_WAITING_TIME: value} for name, value in waited_s.items()}
        self.values |= {name: {constants.VAR_POSITION: value} for name, value in people.items()}
        self.ignored = {}
        self.patience.observe(self)
        return self.ignored


def test_ordinary_traffic_is_not_changed() -> None:
    traffic = Traffic()
    for waited_s in np.arange(0.0, PATIENCE_S + 1.0, 4.0):
        assert traffic.observe({"car": float(waited_s)}, {"anna": CORNER}) == {}


def test_the_short_packaged_recordings_end_before_patience_starts() -> None:
    ends_s = [start_s + minutes * 60.0 for name, (minutes, _, start_s) in JUNCTION_SET.items() if name[:4] == "test"]
    assert max(ends_s) + MARGIN_S <= FROM_S
    traffic = Traffic(FROM_S - 4.0)
    traffic.observe({"car": 396.0}, {"anna": CORNER})
    assert traffic.observe({"car": 400.0}, {"anna": CORNER}) == {}


def test_after_a_cycle_and_a_half_drivers_ignore_standing_pedestrians_outside_their_path() -> None:
    traffic = Traffic()
    traffic.observe({"car": 156.0}, {"anna": CORNER, "ben": OTHER_CORNER, "carl": MIDDLE})
    walked = (OTHER_CORNER[0] + 1.5, OTHER_CORNER[1])
    ignored = traffic.observe(
        {"car": 160.0, "bus": 3.0}, {"anna": CORNER, "ben": walked, "carl": MIDDLE, "dora": CORNER}
    )
    assert ignored == {"car": "anna", "bus": "anna"}


def test_drivers_give_way_again_when_the_standing_pedestrians_have_moved() -> None:
    traffic = Traffic()
    traffic.observe({"car": 156.0}, {"anna": CORNER})
    assert traffic.observe({"car": 160.0}, {"anna": CORNER, "ben": OTHER_CORNER}) == {"car": "anna"}
    assert traffic.observe({"bus": 0.0}, {"anna": CORNER, "ben": OTHER_CORNER}) == {"bus": "anna ben"}
    assert traffic.observe({"bus": 4.0}, {"ben": OTHER_CORNER}) == {"bus": ""}
    assert traffic.observe({"bus": 8.0}, {"ben": OTHER_CORNER}) == {}


def longest_wait_s(movements: Movements) -> float:
    """The longest wait of a car at the stop line or in the queue behind it."""
    found = 0
    for user, kind in enumerate(movements.kind):
        if kind == "car":
            moved = np.abs(np.diff(movements.position[movements.user == user, 1])) > 0.01
            stops = np.flatnonzero(np.concatenate([[True], moved, [True]]))
            found = max(found, int(np.diff(stops).max()))
    return found * 0.125


def test_drivers_of_sumo_follow_the_parameters(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("sumo", reason="SUMO is not installed")
    monkeypatch.setattr(road_users, "CORNER_M", 0.0)  # the snail stands in the way
    monkeypatch.setattr(road_users, "FROM_S", 0.0)
    waits = []
    for limit_s in (60.0, 1000.0):
        monkeypatch.setattr(road_users, "PATIENCE_S", limit_s)
        folder = tmp_path / str(limit_s)
        folder.mkdir()
        signals = (HERE / "signals.add.xml",)
        movements = run_sumo(
            folder, HERE / "network.net.xml", SNAIL, signals, (0.0, 420.0), 1, Patience(layout.JUNCTION_NODE)
        )
        waits.append(longest_wait_s(movements))
    assert waits[0] <= 60.0 + layout.CYCLE_S
    assert waits[1] > 240.0
