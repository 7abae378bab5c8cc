"""True flow: the velocities of the cells of a frame that the bodies of its true scene occupy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import GridSpec, Mask
from gridtrack.evaluation.scoring.body_motions import BodyMotions
from gridtrack.evaluation.scoring.motion import body_of_returns
from gridtrack.recordings.observation import Observation


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
