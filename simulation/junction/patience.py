"""Drivers' patience: after one and a half signal cycles they no longer give way to pedestrians who stand on a crossing.

Pedestrians of JuPedSim sometimes block each other: two who walk round the same corner of a crossing in opposite
directions stand face to face for minutes. They sway while they stand, and drivers of SUMO give way to every pedestrian
who moves on a crossing, so that the traffic of that side is blocked. A real driver would drive on.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

PATIENCE_S = 158.0
"""More than one and a half signal cycles: every arm had one green phase, and most had two."""
FROM_S = 464.0
"""The end of the last short recording in the package: two of them start during such a block, and are not changed."""
OBSERVE_EVERY_S = 4.0
STANDS_WITHIN_M = 1.0
"""A pedestrian who moves less between two observations stands; the slowest one walks 2.5 m."""
AT_JUNCTION_M = 12.0
CORNER_M = 3.7
"""Distance from the middle of each street: half a metre off the kerb, outside the paths of all vehicles."""
WITHIN_SIGHT_M = 100.0
"""Radius that contains the whole streets."""
IGNORE = "junctionModel.ignoreIDs"

Positions = dict[str, tuple[float, float]]


class Patience:
    """Observes the traffic; changes nothing until, after FROM_S, a driver has waited for PATIENCE_S.

    From then on no vehicle gives way to pedestrians who stand at the junction, until all those who stood there at that
    time have moved.
    """

    every_s = OBSERVE_EVERY_S

    def __init__(self, junction: str) -> None:
        self._junction = junction
        self._before: Positions = {}
        self._blocked: set[str] = set()
        self._ignored: set[str] = set()

    def start(self, traffic: Any) -> None:
        """Subscribe, through TraCI, to the vehicles' waiting times and the pedestrians' positions."""
        from traci import constants

        vehicles, pedestrians = constants.CMD_GET_VEHICLE_VARIABLE, constants.CMD_GET_PERSON_VARIABLE
        self._waiting, self._position = constants.VAR_WAITING_TIME, constants.VAR_POSITION
        traffic.junction.subscribeContext(self._junction, vehicles, WITHIN_SIGHT_M, [self._waiting])
        traffic.junction.subscribeContext(self._junction, pedestrians, AT_JUNCTION_M, [self._position])

    def observe(self, traffic: Any) -> None:
        """Called every `every_s` seconds of the simulation."""
        values_of: Mapping[str, Mapping[int, Any]] = traffic.junction.getContextSubscriptionResults(self._junction)
        waited_s = {name: values[self._waiting] for name, values in values_of.items() if self._waiting in values}
        positions = {name: values[self._position] for name, values in values_of.items() if self._position in values}
        standing = standing_at_corners(self._before, positions)
        self._before = positions
        if max(waited_s.values(), default=0.0) > PATIENCE_S and traffic.simulation.getTime() >= FROM_S:
            self._blocked |= standing
        self._blocked &= standing
        ignored = standing if self._blocked else set()
        if ignored or self._ignored:
            for vehicle in waited_s:
                traffic.vehicle.setParameter(vehicle, IGNORE, " ".join(sorted(ignored)))
        self._ignored = ignored


def standing_at_corners(before: Positions, now: Positions) -> set[str]:
    """Pedestrians who moved less than STANDS_WITHIN_M since the last observation, outside the vehicles' paths."""
    return {
        name
        for name in before.keys() & now.keys()
        if np.hypot(*np.subtract(now[name], before[name])) < STANDS_WITHIN_M and min(np.abs(now[name])) > CORNER_M
    }
