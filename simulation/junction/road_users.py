"""Road users of the junction: their types and demand, and the patience of its drivers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

HOURS = 24
ARMS = "NESW"
CARS, BUSES, CYCLISTS, PEDESTRIANS = 0.17, 0.022, 0.22, 0.25
"""Road users per second on all routes together."""
STRAIGHT_SHARE = {"NS": 2.0, "SN": 2.0, "EW": 3.0, "WE": 3.0}
"""Relative demand of the straight routes; a turn has 1. Buses use only the main street, east-west."""
PATIENCE_S = 158.0
"""More than one and a half signal cycles: every arm had one green phase, and most had two."""
FROM_S = 464.0
"""The end of the last short recording in the package: two of them start while traffic is blocked, and must not
change."""
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


class RoadUserType(NamedTuple):
    """A SUMO vehicle type: class label, length and width in metres, share of its class, other SUMO attributes."""

    label: str
    length_m: float
    width_m: float
    share: float
    attributes: str


_CAR = (
    'minGap="1.8" accel="2.0" decel="3.5" sigma="0.3" speedFactor="normc(0.95,0.12,0.6,1.2)" minGapLat="0.5"'
    ' maxSpeedLat="0.8" latAlignment="center"'
)
_BICYCLE = (
    'vClass="bicycle" minGap="0.7" speedFactor="normc(1,0.2,0.6,1.4)" decel="2.5" sigma="0.4" latAlignment="right"'
    ' minGapLat="0.3" maxSpeedLat="0.5"'
)
_WALKER = 'vClass="pedestrian" minGap="0.30" speedFactor="normc(1,0.15,0.6,1.6)"'
_BUS = 'vClass="bus" minGap="2.5" accel="1.0" decel="3.0" speedFactor="normc(0.85,0.05,0.6,1)" sigma="0.3"'

ROAD_USER_TYPES = {
    "car_small": RoadUserType("car", 3.9, 1.7, 0.4, f'vClass="passenger" {_CAR}'),
    "car_large": RoadUserType("car", 4.5, 1.82, 0.45, f'vClass="passenger" {_CAR}'),
    "van": RoadUserType("car", 5.4, 2.0, 0.15, f'vClass="delivery" {_CAR}'),
    "bus_solo": RoadUserType("bus", 11.5, 2.55, 1.0, _BUS),
    "bicycle_fast": RoadUserType("cyclist", 1.75, 0.6, 0.6, f'{_BICYCLE} maxSpeed="5.5" accel="1.1"'),
    "bicycle_slow": RoadUserType("cyclist", 1.6, 0.65, 0.4, f'{_BICYCLE} maxSpeed="4.2" accel="0.9"'),
    "walker_fast": RoadUserType("pedestrian", 0.3, 0.5, 0.7, f'{_WALKER} desiredMaxSpeed="1.35"'),
    "walker_slow": RoadUserType("pedestrian", 0.3, 0.55, 0.2, f'{_WALKER} desiredMaxSpeed="1.05"'),
    "walker_small": RoadUserType("pedestrian", 0.25, 0.4, 0.1, f'{_WALKER} desiredMaxSpeed="1.2"'),
}


def routes() -> str:
    """The demand as SUMO's XML."""
    ways = {a + b: STRAIGHT_SHARE.get(a + b, 1.0) for a in ARMS for b in ARMS if a != b}
    whole = sum(ways.values())
    lines = ["<routes>", *road_user_types()]
    for way, weight in ways.items():
        lines.append(_flow("car", way, CARS * weight / whole))
        lines.append(_flow("cyclist", way, CYCLISTS * weight / whole))
        lines += _walks(way, PEDESTRIANS * weight / whole)
    lines += [_flow("bus", way, BUSES / 2.0) for way in ("EW", "WE")]
    return "\n".join([*lines, "</routes>\n"])


def road_user_types() -> list[str]:
    """One distribution of vehicle types per class, as SUMO's XML."""
    lines = []
    for label in dict.fromkeys(kind.label for kind in ROAD_USER_TYPES.values()):
        lines.append(f'<vTypeDistribution id="{label}">')
        lines += [
            f'<vType id="{name}" length="{kind.length_m}" width="{kind.width_m}" probability="{kind.share}"'
            f" {kind.attributes}/>"
            for name, kind in ROAD_USER_TYPES.items()
            if kind.label == label
        ]
        lines.append("</vTypeDistribution>")
    return lines


def _flow(label: str, way: str, per_second: float) -> str:
    """Vehicles at random times, from the inward street of one arm to the outward street of another."""
    return (
        f'<flow id="{label}{way}" type="{label}" begin="0" end="{HOURS * 3600}" period="exp({per_second:.6f})"'
        f' from="{way[0]}C" to="C{way[1]}" departLane="best" departSpeed="desired"/>'
    )


def _walks(way: str, per_second: float) -> list[str]:
    """Pedestrians between two arms, on both pavements at each end."""
    start, end = way[0], way[1]
    return [
        f'<personFlow id="pedestrian{way}{i}{j}" type="pedestrian" begin="0" end="{HOURS * 3600}"'
        f' period="exp({per_second / 4.0:.6f})" departPosLat="random" departPos="random">'
        f'<walk from="{origin}" to="{destination}" arrivalPos="random"/></personFlow>'
        for i, origin in enumerate((f"{start}C", f"C{start}"))
        for j, destination in enumerate((f"{end}C", f"C{end}"))
    ]


class Patience:
    """Observes the traffic, and resolves a block: after FROM_S, when a driver has waited for PATIENCE_S.

    Vehicles then ignore pedestrians who stand at the junction, until all who stood there at that time have moved.
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
