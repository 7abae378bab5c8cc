"""Targets: the state of each cell of a window in an observed frame, and with truth also of hidden cells."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache, partial

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import GridFrame, GridSpec, Mask, snapped
from gridtrack.common.raycast import directions_of, turned, window_ranges
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


@dataclass(frozen=True, slots=True)
class CrossingBeams:
    """N beams of all sensors that cross the window, in cells from the window's lower-left corner.

    `starts` (N, 2) float64: x, y of the sensor; `directions` (N, 2) float64: unit vectors; `ends` (N,) float64: range
    at which a beam leaves the window, or the sensor's maximum range if that is shorter; `ranges` (N,) float64: measured
    range, or that end for a beam that did not return from the window.
    """

    starts: NDArray[np.float64]
    directions: NDArray[np.float64]
    ends: NDArray[np.float64]
    ranges: NDArray[np.float64]

    @classmethod
    def none(cls) -> CrossingBeams:
        """Those of a frame without scans."""
        return cls(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), np.zeros(0))


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
    """The beams of an observation that cross its window before they return; none if it has no scans.

    An invalid range says nothing of its beam, which is left out.
    """
    found = [CrossingBeams.none()]
    for scan, pose in zip(observation.scans, observation.grid_T_sensor, strict=True):
        start = snapped((np.array([pose.x, pose.y]) - grid.origin) / grid.cell_m)
        directions = turned(directions_of(scan.angle_min, scan.angle_increment, scan.ranges.size), pose.theta)
        enter, leave = window_ranges(start, directions, scan.range_max / grid.cell_m, grid.size)
        ranges = scan.ranges.astype(np.float64) / grid.cell_m
        kept = (scan.ranges >= scan.range_min) & (leave > enter) & (ranges > enter)
        ends = leave[kept]
        starts = np.tile(start, (ends.size, 1))
        found.append(CrossingBeams(starts, directions[kept], ends, np.minimum(ranges[kept], ends)))
    return CrossingBeams(
        *(np.concatenate([getattr(one, name) for one in found]) for name in ("starts", "directions", "ends", "ranges"))
    )


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
