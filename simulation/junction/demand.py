"""The junction's traffic demand: types of road users, their rates and their routes."""

from __future__ import annotations

from typing import NamedTuple

HOURS = 24
ARMS = "NESW"
CARS, BUSES, CYCLISTS, PEDESTRIANS = 0.17, 0.022, 0.22, 0.25
"""Road users a second, all routes together."""
STRAIGHT_SHARE = {"NS": 2.0, "SN": 2.0, "EW": 3.0, "WE": 3.0}
"""Relative demand of the straight routes; a turn has 1. The main street runs east-west; buses use only that one."""


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
    """The demand in the XML of SUMO."""
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
    """One distribution of vehicle types for each class, in the XML of SUMO."""
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
    """Vehicles at random times, from one arm's inward street to another's outward one."""
    return (
        f'<flow id="{label}{way}" type="{label}" begin="0" end="{HOURS * 3600}" period="exp({per_second:.6f})"'
        f' from="{way[0]}C" to="C{way[1]}" departLane="best" departSpeed="desired"/>'
    )


def _walks(way: str, per_second: float) -> list[str]:
    """Pedestrians between two arms, on either pavement at each end."""
    start, end = way[0], way[1]
    return [
        f'<personFlow id="pedestrian{way}{i}{j}" type="pedestrian" begin="0" end="{HOURS * 3600}"'
        f' period="exp({per_second / 4.0:.6f})" departPosLat="random" departPos="random">'
        f'<walk from="{origin}" to="{destination}" arrivalPos="random"/></personFlow>'
        for i, origin in enumerate((f"{start}C", f"C{start}"))
        for j, destination in enumerate((f"{end}C", f"C{end}"))
    ]
