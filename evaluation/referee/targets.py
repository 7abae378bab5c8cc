"""Targets: the state of each cell of a window in an observed frame, and with truth also of hidden cells."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache, lru_cache, partial
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec, Mask, snapped
from gridtrack.common.raycast import directions_of, turned, window_ranges
from gridtrack.common.scan import Scan
from gridtrack.common.scene import UNLABELLED
from gridtrack.evaluation.referee.motion import BodyMotions, body_of_returns
from gridtrack.evaluation.referee.people import PeopleInWindow
from gridtrack.evaluation.referee.strata import RANGES, REGIONS, STRATA_WITH_TRUTH, SUMS_OF_REGIONS, RegionMaps
from gridtrack.recordings.observation import Observation, check_labels, labelled_returns
from gridtrack.recordings.truth import FREE, INTERIOR, OUTLINE, TruthGrid, truth_grid

SEEN_FREE, SEEN_OCCUPIED, HIDDEN_FREE, HIDDEN_OCCUPIED, NOT_SCORED = range(5)
"""States of a cell in a frame; odd states are positives. A hidden cell is occupied if a true outline crosses it."""
_STATE_OF_COVER = np.zeros(3, np.uint8)
_STATE_OF_COVER[[FREE, OUTLINE, INTERIOR]] = HIDDEN_FREE, HIDDEN_OCCUPIED, NOT_SCORED
_NO_CELLS, _NO_LABELS = np.zeros(0, np.int64), np.zeros(0, np.uint8)


@dataclass(frozen=True, slots=True, eq=False)
class BeamPaths:
    """N beams of all sensors that cross the window, in cells from the window's lower-left corner.

    `starts` (N, 2) float64: x, y of the sensor; `directions` (N, 2) float64: unit vectors; `enters` (N,) float64: range
    at which a beam enters the window; `ends` (N,) float64: range at which it leaves the window, or the sensor's maximum
    range if that is shorter. `crossing` (B,) bool: which of the beams of all scans they are.
    """

    starts: NDArray[np.float64]
    directions: NDArray[np.float64]
    enters: NDArray[np.float64]
    ends: NDArray[np.float64]
    crossing: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class CrossingBeams:
    """The beams of a frame along `paths`: the same object for frames of a sensor at rest.

    `ranges` (N,) float64, cells: the measured range, or the end of its path for a beam that did not return from the
    window; NaN for an invalid range, and for a return before the window.
    """

    paths: BeamPaths
    ranges: NDArray[np.float64]

    @classmethod
    def none(cls) -> CrossingBeams:
        """Those of a frame without scans."""
        return cls(_paths((), GridSpec()), np.zeros(0))


@dataclass(frozen=True, slots=True)
class TrueFlow:
    """The occupied cells with a known velocity: `cells` (N,) int64, row * M + column; `velocity` (N, 2) float64, m/s.

    Along the axes of the window, of the body at the centre of the cell.
    """

    cells: NDArray[np.int64]
    velocity: NDArray[np.float64]

    @classmethod
    def none(cls) -> TrueFlow:
        """Without ground truth."""
        return cls(np.zeros(0, np.int64), np.zeros((0, 2)))


@dataclass(frozen=True, slots=True)
class Target:
    """A frame in the window of a forecast, and the states that the forecast of it is scored against.

    `state` (M, M) uint8 of the states above; without truth no hidden cell is scored. `motion` (M, M) uint8: the part of
    each dynamic cell, an index into PARTS. `cells` (N,) int64, row * M +
    column: the occupied cells with a known class, visible and hidden; `labels` (N,) uint8: their classes, indices into
    the recording's classes. `beams` cross the window. `flow()`: the true velocities, found when they
    are first asked for. `people`: None where no people are annotated.
    """

    frame: GridFrame
    state: NDArray[np.uint8]
    motion: NDArray[np.uint8]
    cells: NDArray[np.int64] = field(default_factory=lambda: _NO_CELLS)
    labels: NDArray[np.uint8] = field(default_factory=lambda: _NO_LABELS)
    beams: CrossingBeams = field(default_factory=CrossingBeams.none)
    flow: Callable[[], TrueFlow] = TrueFlow.none
    people: PeopleInWindow | None = None

    @classmethod
    def of_frame(cls, frame: GridFrame) -> Target:
        """The target of a frame without truth and labels, in which every dynamic cell is open."""
        state = np.where(frame.visible, frame.occupied, np.uint8(NOT_SCORED)).astype(np.uint8)
        return cls(frame, state, np.zeros_like(state))


def target_of(
    observation: Observation,
    grid: GridSpec,
    classes: Sequence[str],
    motion: NDArray[np.uint8],
    bodies: BodyMotions | None = None,
) -> Target:
    """The target of an observation in its window, with the truth and labels that it has. Raises RecordingError.

    `bodies` are the true motions, if they are known.
    """
    frame = observation.frame
    truth = _truth(observation, grid)
    target = Target.of_frame(frame)
    if truth is not None:
        target.state[~frame.visible] = _STATE_OF_COVER[truth.cover[~frame.visible]]
    cells, labels = labelled_returns(observation.scans, observation.grid_T_sensor, grid)
    if truth is not None:
        hidden = np.flatnonzero(~frame.visible & (truth.labels != UNLABELLED))
        cells, labels = np.concatenate([cells, hidden]), np.concatenate([labels, truth.labels.ravel()[hidden]])
    check_labels(labels, classes, observation.time_s)
    beams = crossing_beams(observation, grid)
    if truth is None or bodies is None:
        return Target(frame, target.state, motion, cells, labels, beams)
    flow = cache(partial(true_flow, bodies, observation, truth.bodies, target.state == HIDDEN_OCCUPIED, grid))
    return Target(frame, target.state, motion, cells, labels, beams, flow)


def _truth(observation: Observation, grid: GridSpec) -> TruthGrid | None:
    scene = observation.scene
    return None if scene is None else truth_grid(scene, grid, observation.reference_T_grid)


def crossing_beams(observation: Observation, grid: GridSpec) -> CrossingBeams:
    """The beams of an observation that cross its window; none if it has no scans."""
    scans = observation.scans
    paths = _paths(tuple(map(_Sweep.of, scans, observation.grid_T_sensor)), grid)
    valid = [np.where(scan.ranges >= scan.range_min, scan.ranges.astype(np.float64), np.nan) for scan in scans]
    ranges = np.concatenate([np.zeros(0), *valid])[paths.crossing] / grid.cell_m
    return CrossingBeams(paths, np.where(ranges > paths.enters, np.minimum(ranges, paths.ends), np.nan))


class _Sweep(NamedTuple):
    """The beams of a scan, whatever they measured."""

    grid_T_sensor: SE2
    angle_min: float
    angle_increment: float
    beams: int
    range_max: float

    @classmethod
    def of(cls, scan: Scan, grid_T_sensor: SE2) -> _Sweep:
        return cls(grid_T_sensor, scan.angle_min, scan.angle_increment, scan.ranges.size, scan.range_max)


@lru_cache(maxsize=4)
def _paths(sweeps: tuple[_Sweep, ...], grid: GridSpec) -> BeamPaths:
    """The paths of all beams of the sweeps that cross the window."""
    starts, directions, ranges, crossing = (
        [np.zeros((0, 2))],
        [np.zeros((0, 2))],
        [np.zeros((0, 2))],
        [np.zeros(0, bool)],
    )
    for sweep in sweeps:
        pose = sweep.grid_T_sensor
        start = snapped((np.array([pose.x, pose.y]) - grid.origin) / grid.cell_m)
        all_directions = turned(directions_of(sweep.angle_min, sweep.angle_increment, sweep.beams), pose.theta)
        enter, leave = window_ranges(start, all_directions, sweep.range_max / grid.cell_m, grid.size)
        crossing.append(leave > enter)
        directions.append(all_directions[crossing[-1]])
        ranges.append(np.stack([enter, leave], axis=1)[crossing[-1]])
        starts.append(np.tile(start, (len(directions[-1]), 1)))
    enters, ends = np.concatenate(ranges).T.copy()
    return BeamPaths(np.concatenate(starts), np.concatenate(directions), enters, ends, np.concatenate(crossing))


def true_flow(
    bodies: BodyMotions, observation: Observation, outlines: NDArray[np.int32], hidden: Mask, grid: GridSpec
) -> TrueFlow:
    """The flow of an observation in its window, whose scene has these `bodies`. Raises RecordingError.

    A visible occupied cell is of the body that its return lies on; a `hidden` one (M, M) is of the body whose outline
    passes through it, `outlines` (M, M). A body that was not in the scene before has no velocity.
    """
    body = np.where(hidden, outlines, body_of_returns(bodies.scene, observation, grid)).ravel()
    cells = np.flatnonzero(body >= 0)
    centres = grid.cell_centres(np.ones(grid.shape, np.bool_))[cells].astype(np.float64)
    velocity = bodies.velocities(body[cells], centres, observation.reference_T_grid)
    known = np.isfinite(velocity).all(axis=1)
    return TrueFlow(cells[known], velocity[known])


NO_REGION = REGIONS
"""The region of a cell that is not scored."""


def cell_regions(target: Target, region_maps: RegionMaps, ages: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The region (M, M) of each cell of a target; NO_REGION where it is not scored."""
    region: NDArray[np.uint8] = _regions(target.state, target.motion, region_maps.visible, region_maps.hidden, ages)
    return region


@numba.njit(cache=True, nogil=True)
def _regions(state, motion, visible, hidden, ages):  # type: ignore[no-untyped-def]
    region = np.full(state.shape, NO_REGION, np.uint8)
    for row in range(state.shape[0]):
        for column in range(state.shape[1]):
            at = row, column
            if state[at] < HIDDEN_FREE:
                region[at] = visible[at] + RANGES * motion[at]
            elif state[at] != NOT_SCORED:
                region[at] = hidden[at] + ages[at]
    return region


def members(strata: Sequence[str]) -> NDArray[np.bool_]:
    """Whether each region, and last NO_REGION, is part of each stratum: (K, REGIONS + 1)."""
    found = np.zeros((len(strata), REGIONS + 1), np.bool_)
    found[:, :NO_REGION] = SUMS_OF_REGIONS[[STRATA_WITH_TRUTH.index(name) for name in strata]]
    return found
