"""What people do in a place: pass through, go about, stand, wait, talk in groups, turn round, pace, sit."""

from __future__ import annotations

import math

import numpy as np
import shapely
from shapely import Polygon

from gridtrack.simulation.tracks import Corner
from gridtrack.simulation.walkers import Companion, Walker
from gridtrack.simulation.worlds.crowd import Plan, Stop

WALKING_M_S = (1.2, 0.25)
"""Mean and standard deviation of the preferred speed of adults, with U. Weidmann, "Transporttechnik der Fussgänger",
1993, somewhat slower than his 1.34 m/s: these places are small."""
COMPANIONS: dict[Companion, float] = {
    "nothing": 0.68,
    "bag": 0.12,
    "coat": 0.1,
    "trolley": 0.05,
    "stroller": 0.03,
    "wheelchair": 0.02,
}
BEHAVIOURS = {"pass": 0.3, "wander": 0.3, "stand": 0.12, "group": 0.14, "turn": 0.07, "pace": 0.07}


def build(random: np.random.Generator) -> Walker:
    """Somebody's build; one in eight is a child."""
    child = random.random() < 0.12
    height_m = random.uniform(1.0, 1.5) if child else float(np.clip(random.normal(1.71, 0.1), 1.5, 2.0))
    companion: Companion = "nothing" if child else str(random.choice([*COMPANIONS], p=[*COMPANIONS.values()]))  # type: ignore[assignment]
    return Walker(
        height_m=round(height_m, 2),
        apart_m=round(height_m * random.uniform(0.06, 0.12), 3),
        companion=companion,
        dark=bool(random.random() < 0.15),
        phase=round(random.uniform(0.0, 1.0), 3),
    )


def torso(walker: Walker, random: np.random.Generator) -> tuple[float, float]:
    """Length and width of a body at the chest, metres."""
    share = walker.height_m / 1.72
    return float(random.uniform(0.2, 0.3) * share), float(random.uniform(0.38, 0.52) * share)


class Planner:
    """Draws plans for a place: somewhere on `inside` of `ground`, and `doors` by which people come and go."""

    def __init__(self, ground: Polygon, inside: Polygon, doors: list[Corner], random: np.random.Generator) -> None:
        self._inside = ground.buffer(-0.25).intersection(inside)
        self._doors, self._random = doors, random
        self._bounds = ground.bounds

    def anywhere(self) -> Corner:
        """A random place."""
        x0, y0, x1, y1 = self._bounds
        for _ in range(500):
            at = shapely.Point(self._random.uniform(x0, x1), self._random.uniform(y0, y1))
            if self._inside.contains(at):
                break
        return (at.x, at.y)

    def plans(self, people: int, seconds: float) -> list[Plan]:
        """Plans for about so many people at a time."""
        found: list[Plan] = []
        while len(found) < people:
            behaviour = str(self._random.choice([*BEHAVIOURS], p=[*BEHAVIOURS.values()]))
            found += self._group() if behaviour == "group" else self._together(behaviour, seconds)
        return found

    def _together(self, behaviour: str, seconds: float) -> list[Plan]:
        """One person, or two or three who walk side by side."""
        random = self._random
        companions = int(random.choice([1, 2, 3], p=[0.75, 0.2, 0.05])) if behaviour in ("pass", "wander") else 1
        speed = float(np.clip(random.normal(*WALKING_M_S), 0.5, 1.9))
        start_s = 0.0
        leaves = False
        if behaviour == "pass":
            ends = [
                self._doors[k] if self._doors else self.anywhere()
                for k in random.integers(max(len(self._doors), 1), size=2)
            ]
            start, start_s, leaves = ends[0], float(random.uniform(0.0, seconds)), True
            stops = [
                *([Stop(self.anywhere(), self._while())] if random.random() < 0.4 or ends[0] == ends[1] else []),
                Stop(ends[1]),
            ]
        elif behaviour == "stand":
            start = self.anywhere()
            stops = [
                Stop(start, float(random.uniform(5.0, 40.0)), float(random.uniform(-math.pi, math.pi)))
                for _ in range(4)
            ]
        elif behaviour == "wander":
            start = self.anywhere()
            stops = [Stop(self.anywhere(), self._while(), self._look()) for _ in range(6)]
        else:
            start, far = self.anywhere(), self.anywhere()
            pause_s = float(random.uniform(0.2, 1.5)) if behaviour == "turn" else self._while()
            stops = [Stop(far, pause_s), Stop(start, pause_s)]
        aside = [(0.0, 0.0), (0.55, 0.2), (-0.45, 0.45)]
        return [
            Plan(
                _by(start, aside[k]),
                tuple(Stop(_by(s.at, aside[k]), s.wait_s, s.facing) for s in stops),
                speed,
                0.17,
                start_s,
                leaves,
            )
            for k in range(companions)
        ]

    def _group(self) -> list[Plan]:
        """People who stand in a circle and talk; some leave after a while."""
        random = self._random
        (x, y), size = self.anywhere(), int(random.integers(2, 5))
        radius_m, turned = random.uniform(0.45, 0.8), random.uniform(0.0, math.tau)
        found = []
        for k in range(size):
            angle = turned + math.tau * k / size + random.normal(0.0, 0.15)
            at = (x + radius_m * math.cos(angle), y + radius_m * math.sin(angle))
            stops = [Stop(at, float(random.uniform(10.0, 90.0)), angle + math.pi)]
            if random.random() < 0.5:
                stops.append(Stop(self.anywhere(), self._while(), self._look()))
            found.append(Plan(at, tuple(stops), float(random.uniform(0.7, 1.3)), 0.16))
        return found

    def _while(self) -> float:
        """How long somebody stays: often not at all."""
        return float(self._random.exponential(6.0)) if self._random.random() < 0.6 else 0.0

    def _look(self) -> float | None:
        return float(self._random.uniform(-math.pi, math.pi)) if self._random.random() < 0.5 else None


def robot_plan(planner: Planner, random: np.random.Generator, largest_speed: float = 0.9) -> Plan:
    """A robot that goes about, stops, and turns on the spot."""
    look = [float(random.uniform(-math.pi, math.pi)) if random.random() < 0.5 else None for _ in range(12)]
    stops = tuple(Stop(planner.anywhere(), float(random.choice([0.0, 2.0, 5.0])), facing) for facing in look)
    return Plan(planner.anywhere(), stops, float(random.uniform(0.3, largest_speed)), 0.28)


def _by(at: Corner, offset: Corner) -> Corner:
    return (at[0] + offset[0], at[1] + offset[1])
