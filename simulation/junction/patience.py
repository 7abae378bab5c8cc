"""Drivers' patience: after a cycle and a half of the signals they no longer give way to people who only stand there.

JuPedSim's walkers now and then wedge: two who go round the same corner of a crossing the opposite ways stand chest to
chest, for minutes. They sway while they stand, and SUMO's drivers give way to whoever moves on a crossing, so that the
arms on that side never get a green that they can use. A real driver sees that nobody walks there, and goes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

PATIENCE_S = 158.0
"""More than a cycle and a half of the signals: every arm had its green, and most had two."""
FROM_S = 464.0
"""When the last of the short recordings that ship is over: two of them begin behind such a wedge, and stay as made."""
LOOK_EVERY_S = 4.0
STANDS_WITHIN_M = 1.0
"""Who moves less between two looks stands; the slowest walker goes 2.5 m."""
AT_JUNCTION_M = 12.0
CORNER_M = 3.7
"""From either street's middle: half a metre off the kerb, where no vehicle's way leads."""
WITHIN_SIGHT_M = 100.0
"""The whole streets."""
IGNORE = "junctionModel.ignoreIDs"

Positions = dict[str, tuple[float, float]]


class Patience:
    """Looks at the traffic as it is simulated; changes nothing until, after FROM_S, a driver has stood for PATIENCE_S.

    From then on no vehicle gives way to anybody who stands at the junction, for as long as one of those stands who
    stood there at that moment.
    """

    every_s = LOOK_EVERY_S

    def __init__(self, junction: str) -> None:
        self._junction = junction
        self._before: Positions = {}
        self._wedged: set[str] = set()
        self._ignored: set[str] = set()

    def begin(self, traffic: Any) -> None:
        """Ask SUMO, by its TraCI connection, to tell the vehicles' waiting times and the walkers' positions."""
        from traci import constants

        vehicles, walkers = constants.CMD_GET_VEHICLE_VARIABLE, constants.CMD_GET_PERSON_VARIABLE
        self._waiting, self._position = constants.VAR_WAITING_TIME, constants.VAR_POSITION
        traffic.junction.subscribeContext(self._junction, vehicles, WITHIN_SIGHT_M, [self._waiting])
        traffic.junction.subscribeContext(self._junction, walkers, AT_JUNCTION_M, [self._position])

    def look(self, traffic: Any) -> None:
        """Once every `every_s` seconds of the simulation."""
        told: Mapping[str, Mapping[int, Any]] = traffic.junction.getContextSubscriptionResults(self._junction)
        waited_s = {name: values[self._waiting] for name, values in told.items() if self._waiting in values}
        positions = {name: values[self._position] for name, values in told.items() if self._position in values}
        standing = standing_at_corners(self._before, positions)
        self._before = positions
        if max(waited_s.values(), default=0.0) > PATIENCE_S and traffic.simulation.getTime() >= FROM_S:
            self._wedged |= standing
        self._wedged &= standing
        ignored = standing if self._wedged else set()
        if ignored or self._ignored:
            for vehicle in waited_s:
                traffic.vehicle.setParameter(vehicle, IGNORE, " ".join(sorted(ignored)))
        self._ignored = ignored


def standing_at_corners(before: Positions, now: Positions) -> set[str]:
    """Who was there at the last look, has moved less than STANDS_WITHIN_M since, and is out of the vehicles' way."""
    return {
        name
        for name in before.keys() & now.keys()
        if np.hypot(*np.subtract(now[name], before[name])) < STANDS_WITHIN_M and min(np.abs(now[name])) > CORNER_M
    }
