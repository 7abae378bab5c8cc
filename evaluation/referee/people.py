"""Annotated people in the window of a forecast: their cells, and which returns are in motion by the annotation."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec, Mask
from gridtrack.common.scene import Person
from gridtrack.evaluation.referee.motion import MIN_SPEED_MPS, parts_of
from gridtrack.recordings.observation import Observation
from gridtrack.recordings.people import PERSON_M


@dataclass(frozen=True, slots=True)
class PeopleInWindow:
    """The N annotated people of a frame with cells in the window of a forecast.

    `cells`: of each person the cells (K,) int64, row * M + column, with a centre within PERSON_M. `moving` (N,) bool:
    faster than MIN_SPEED_MPS. `motion` (M, M) uint8: the part of each dynamic cell as in a target, but a return is in
    motion where it is on a cell of a moving person.
    """

    cells: tuple[NDArray[np.int64], ...]
    moving: NDArray[np.bool_]
    motion: NDArray[np.uint8]

    @property
    def near(self) -> Mask:
        """The cells (M, M) of all people."""
        return _marked(self.cells, self.motion.shape)


def people_in(observation: Observation, grid: GridSpec, dynamic: Mask) -> PeopleInWindow | None:
    """The annotated people of an observation in its window; None if nothing is annotated at its stamp.

    `dynamic` (M, M) are the dynamic cells of the window.
    """
    if observation.people is None:
        return None
    grid_T_world = observation.reference_T_grid.inverse()
    found = [(_cells_of(person, grid_T_world, grid), person.speed_mps > MIN_SPEED_MPS) for person in observation.people]
    found = [(cells, moves) for cells, moves in found if cells.size]
    of_moving = _marked(tuple(cells for cells, moves in found if moves), grid.shape)
    occupied = observation.frame.occupied
    motion = parts_of(occupied & of_moving, occupied, dynamic, grid)
    return PeopleInWindow(tuple(cells for cells, _ in found), np.array([moves for _, moves in found], np.bool_), motion)


def _cells_of(person: Person, grid_T_world: SE2, grid: GridSpec) -> NDArray[np.int64]:
    """The cells (K,) of the window with a centre within PERSON_M of a person."""
    place = grid_T_world.apply(np.array([(person.x, person.y)]))[0]
    x, y = (place - grid.origin) / grid.cell_m
    reach = PERSON_M / grid.cell_m
    if not (-reach <= x <= grid.size + reach and -reach <= y <= grid.size + reach):
        return np.zeros(0, np.int64)
    rows, columns = (
        np.arange(max(math.floor(at - reach), 0), min(math.ceil(at + reach) + 1, grid.size)) for at in (y, x)
    )
    distance = np.hypot(rows[:, None] + 0.5 - y, columns + 0.5 - x)
    near: NDArray[np.int64] = (rows[:, None] * grid.size + columns)[distance <= reach + 1e-9]
    return near


def _marked(cells: tuple[NDArray[np.int64], ...], shape: tuple[int, ...]) -> Mask:
    marked = np.zeros(shape, np.bool_)
    for own in cells:
        marked.ravel()[own] = True
    return marked
