"""Walking people by JuPedSim's collision-free speed model, each with a plan of stops.

Model: A. Tordeux, M. Chraibi and A. Seyfried, "Collision-free speed model for pedestrian dynamics", Traffic and
Granular Flow '15, 2016.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import jupedsim
import numpy as np
import shapely
from numpy.typing import NDArray
from shapely import Polygon
from shapely.ops import nearest_points

from gridtrack.simulation.motion import headings, smoothed
from gridtrack.simulation.sumo import SimulationError
from gridtrack.simulation.tracks import Corner

CROWD_STEP_S = 0.1
SUBSTEPS = 5
STOP_MARGIN_M = 0.3
"""Minimum distance of a stop from the edge of the ground; JuPedSim needs the radius of the person."""
REACHED_M, ALMOST_M = 0.3, 0.8
GIVES_UP_S = 8.0
"""A person who does not get nearer to a stop for this long continues to the next one."""
SMOOTHING_STD_S, TURNING_STD_S = 0.3, 0.35
"""The model changes speed and direction instantly; people take some tenths of a second."""
SWAY_M, SWAY_RAD, SWAY_STD_S = 0.025, 0.15, 0.8
ENTRY_TRIES = 200


@dataclass(frozen=True)
class Stop:
    """A place, the time to stand there, and the heading meanwhile (radians; None: unchanged)."""

    at: Corner
    wait_s: float = 0.0
    facing: float | None = None


@dataclass(frozen=True)
class Plan:
    """The plan of a person: from `start` at `start_s` to all `stops`, repeatedly, or once if the person `leaves`."""

    start: Corner
    stops: tuple[Stop, ...]
    speed: float
    radius_m: float = 0.2
    start_s: float = 0.0
    leaves: bool = False


@dataclass
class MoverPath:
    """Position (n, 2) and heading (n,) of a road user every CROWD_STEP_S from step `first`."""

    first: int
    position: NDArray[np.float64]
    heading: NDArray[np.float64]


@dataclass
class _Progress:
    """The state of one person in the simulation."""

    plan: Plan
    agent: int = -1
    first: int = 0
    stop: int = 0
    waits_until_s: float = -1.0
    nearest_m: float = math.inf
    nearest_s: float = 0.0
    positions: list[Corner] = field(default_factory=list)
    facing: list[float] = field(default_factory=list)
    """NaN while walking."""
    gone: bool = False
    gone_s: float = -math.inf
    """The time of the removal; the simulation executes it in its next step."""


def walk(ground: Polygon, plans: Sequence[Plan], seconds: float, random: np.random.Generator) -> list[MoverPath | None]:
    """The path of each plan during `seconds`, in order; None if the person found no room to enter.

    Same arguments, same paths. `ground` is connected; stops outside are moved to it. Raises SimulationError.
    """
    everybody = [_Progress(plan) for plan in plans]
    try:
        _simulate(ground, everybody, math.ceil(seconds / CROWD_STEP_S))
    except RuntimeError as error:  # of JuPedSim, for example if a person is pushed off the ground
        raise SimulationError(f"JuPedSim failed: {str(error).splitlines()[0]}") from error
    return [_path(person, random) if len(person.positions) > 3 else None for person in everybody]


def _simulate(ground: Polygon, everybody: Sequence[_Progress], steps: int) -> None:
    """Simulate `steps` steps."""
    simulation = jupedsim.Simulation(
        model=jupedsim.CollisionFreeSpeedModelV2(), geometry=ground, dt=CROWD_STEP_S / SUBSTEPS
    )
    stage = simulation.add_direct_steering_stage()
    journey = simulation.add_journey(jupedsim.JourneyDescription([stage]))
    inner = ground.buffer(-STOP_MARGIN_M)
    for step in range(steps):
        for person in everybody:
            if person.agent < 0 and not person.gone and person.plan.start_s <= step * CROWD_STEP_S:
                _enter(simulation, person, everybody, inner, journey, stage, step)
        simulation.iterate(SUBSTEPS)
        for person in everybody:
            if person.agent >= 0 and not person.gone:
                _advance(simulation, person, inner, step * CROWD_STEP_S)


def on_ground(inner: Polygon, at: Corner) -> Corner:
    """The nearest place to `at` on `inner`."""
    found, _ = nearest_points(inner, shapely.Point(at))
    return (found.x, found.y)


def _enter(
    simulation: jupedsim.Simulation,
    person: _Progress,
    everybody: Sequence[_Progress],
    inner: Polygon,
    journey: int,
    stage: int,
    step: int,
) -> None:
    """Let the person enter if the place is free; else it is tried again in the next step."""
    plan = person.plan
    start = on_ground(inner, plan.start)
    now_s = step * CROWD_STEP_S
    inside = (o for o in everybody if o.agent >= 0 and (not o.gone or now_s - o.gone_s < 1.5 * CROWD_STEP_S))
    if any(math.dist(start, o.positions[-1]) < plan.radius_m + o.plan.radius_m + 0.1 for o in inside):
        person.gone = now_s - plan.start_s > ENTRY_TRIES * CROWD_STEP_S
        return
    parameters = jupedsim.CollisionFreeSpeedModelV2AgentParameters(
        position=start, journey_id=journey, stage_id=stage, desired_speed=plan.speed, radius=plan.radius_m
    )
    person.agent, person.first = simulation.add_agent(parameters), step
    person.nearest_s = step * CROWD_STEP_S
    person.positions.append(start)
    person.facing.append(math.nan)
    _head_for(simulation, person, inner)


def _head_for(simulation: jupedsim.Simulation, person: _Progress, inner: Polygon) -> None:
    agent = simulation.agent(person.agent)
    agent.target = on_ground(inner, person.plan.stops[person.stop].at)
    agent.model.desired_speed = person.plan.speed
    person.nearest_m = math.inf


def _advance(simulation: jupedsim.Simulation, person: _Progress, inner: Polygon, now_s: float) -> None:
    """Record the person's position, and begin or end a stop."""
    agent, stop = simulation.agent(person.agent), person.plan.stops[person.stop]
    at = (float(agent.position[0]), float(agent.position[1]))
    waiting = person.waits_until_s >= 0.0
    person.positions.append(at)
    person.facing.append(math.nan if not waiting or stop.facing is None else stop.facing)
    if waiting:
        if now_s >= person.waits_until_s:
            _next_stop(simulation, person, inner, now_s)
        return
    distance_m = math.dist(at, agent.target)
    if distance_m < person.nearest_m - 0.05:
        person.nearest_m, person.nearest_s = distance_m, now_s
    stuck = now_s - person.nearest_s > GIVES_UP_S or (distance_m < ALMOST_M and now_s - person.nearest_s > 1.0)
    if distance_m < REACHED_M or stuck:
        person.waits_until_s = now_s + stop.wait_s
        agent.model.desired_speed = 0.0 if stop.wait_s > 0.0 else person.plan.speed


def _next_stop(simulation: jupedsim.Simulation, person: _Progress, inner: Polygon, now_s: float) -> None:
    person.waits_until_s, person.nearest_s = -1.0, now_s
    person.stop += 1
    if person.stop == len(person.plan.stops) and person.plan.leaves:
        simulation.mark_agent_for_removal(person.agent)
        person.gone, person.gone_s = True, now_s
        return
    person.stop %= len(person.plan.stops)
    _head_for(simulation, person, inner)


def _path(person: _Progress, random: np.random.Generator) -> MoverPath:
    """The smoothed path with sway."""
    raw = np.array(person.positions)
    facing = np.array(person.facing)
    position = smoothed(raw, SMOOTHING_STD_S / CROWD_STEP_S)
    resting = float(facing[0]) if np.isfinite(facing[0]) else float(random.uniform(-math.pi, math.pi))
    heading = headings(position, CROWD_STEP_S, TURNING_STD_S / CROWD_STEP_S, resting)
    looks = np.isfinite(facing)
    if looks.any():
        heading = smoothed(np.unwrap(np.where(looks, facing, heading))[:, None], TURNING_STD_S / CROWD_STEP_S)[:, 0]
    return swaying(MoverPath(person.first, position, heading), random)


def swaying(path: MoverPath, random: np.random.Generator) -> MoverPath:
    """The path with small slow motions, as of standing people."""
    n = len(path.heading)
    sway = smoothed(random.standard_normal((n, 3)), SWAY_STD_S / CROWD_STEP_S) * math.sqrt(
        2.0 * math.sqrt(math.pi) * SWAY_STD_S / CROWD_STEP_S
    )
    return MoverPath(path.first, path.position + SWAY_M * sway[:, :2], path.heading + SWAY_RAD * sway[:, 2])
