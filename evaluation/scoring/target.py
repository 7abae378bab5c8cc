"""Targets: the state of each cell of a window in an observed frame, and with truth also of hidden cells."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache, partial

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.common.scene import UNLABELLED
from gridtrack.evaluation.scoring.body_motions import BodyMotions
from gridtrack.evaluation.scoring.returned_beams import ReturnedBeams, returned_beams
from gridtrack.evaluation.scoring.true_flow import TrueFlow, true_flow
from gridtrack.recordings.observation import Observation, check_labels, labelled_returns
from gridtrack.recordings.truth import FREE, INTERIOR, OUTLINE, TruthGrid, truth_grid

SEEN_FREE, SEEN_OCCUPIED, HIDDEN_FREE, HIDDEN_OCCUPIED, NOT_SCORED = range(5)
"""States of a cell in a frame; odd states are positives. A hidden cell is occupied if a true outline crosses it."""
_STATE_OF_COVER = np.zeros(3, np.uint8)
_STATE_OF_COVER[[FREE, OUTLINE, INTERIOR]] = HIDDEN_FREE, HIDDEN_OCCUPIED, NOT_SCORED
_NO_CELLS, _NO_LABELS = np.zeros(0, np.int64), np.zeros(0, np.uint8)


@dataclass(frozen=True, slots=True)
class Target:
    """A frame in the window of a forecast, and the states that the forecast of it is scored against.

    `state` (M, M) uint8 of the states above; without truth no hidden cell is scored. `motion` (M, M) uint8: the part of
    each dynamic cell, an index into PARTS. `cells` (N,) int64, row * M +
    column: the occupied cells with a known class, visible and hidden; `labels` (N,) uint8: their classes, indices into
    the recording's classes. `beams` are those that ended in the window. `flow()`: the true velocities, found when they
    are first asked for.
    """

    frame: GridFrame
    state: NDArray[np.uint8]
    motion: NDArray[np.uint8]
    cells: NDArray[np.int64] = field(default_factory=lambda: _NO_CELLS)
    labels: NDArray[np.uint8] = field(default_factory=lambda: _NO_LABELS)
    beams: ReturnedBeams = field(default_factory=ReturnedBeams.none)
    flow: Callable[[], TrueFlow] = TrueFlow.none

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

    `bodies` are the true motions, where they are known.
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
    beams = returned_beams(observation, grid)
    if truth is None or bodies is None:
        return Target(frame, target.state, motion, cells, labels, beams)
    flow = cache(partial(true_flow, bodies, observation, truth.bodies, target.state == HIDDEN_OCCUPIED, grid))
    return Target(frame, target.state, motion, cells, labels, beams, flow)


def _truth(observation: Observation, grid: GridSpec) -> TruthGrid | None:
    scene = observation.scene
    return None if scene is None else truth_grid(scene, grid, observation.reference_T_grid)
