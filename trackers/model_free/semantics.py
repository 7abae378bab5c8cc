"""Class probabilities of the cells in a forecast: from the cell prior, and from the tracks of observed returns."""

from __future__ import annotations

from collections.abc import Sequence

import numba
import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import GridSpec, Mask
from gridtrack.trackers.model_free.tracks import Track

Planes = NDArray[np.float32]

MIN_PRIOR_WEIGHT = 1e-6
"""Smallest weight of the prior in a cell: without a track, the classes of the cell are those of the prior."""


def weight_by_cell_prior(occupancy: Planes, cell_prior: Planes) -> Planes:
    """Semantics (steps+1, K, M, M), not normalised: the background occupancy times the `cell_prior` (K, M, M)."""
    semantics = np.empty((len(occupancy), *cell_prior.shape), np.float32)
    _weight_by_cell_prior(semantics, occupancy, cell_prior)
    return semantics


def attribute(
    semantics: Planes, cell_prior: Planes, occupied: Mask, tracks: Sequence[Track], classes: Planes, grid: GridSpec
) -> None:
    """Set the classes of the `occupied` cells (M, M) of the observed frame in its `semantics` (K, M, M).

    The returns of a track have its `classes` (T, K), the other returns those of `cell_prior`.
    """
    semantics[:, occupied] = cell_prior[:, occupied]
    seen = [number for number, track in enumerate(tracks) if not track.unseen]
    if seen:
        cells, inside = grid.cells_of(np.concatenate([tracks[number].returns for number in seen]))
        owner = np.repeat(seen, [len(tracks[number].returns) for number in seen])[inside]
        semantics[:, cells[inside, 0], cells[inside, 1]] = classes[owner].T


def normalise(semantics: Planes) -> None:
    """Scale the classes of each cell (steps+1, K, M, M) to sum 1, in place; each sum must be positive."""
    steps, classes, rows, columns = semantics.shape
    _normalise(semantics.reshape(steps, classes, rows * columns))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _weight_by_cell_prior(semantics, occupancy, cell_prior):  # type: ignore[no-untyped-def]
    steps, classes, size, _ = semantics.shape
    for step in range(steps):
        for k in range(classes):
            for row in range(size):
                into, shown, share = semantics[step, k, row], occupancy[step, row], cell_prior[k, row]
                for column in range(size):
                    into[column] = max(shown[column], np.float32(MIN_PRIOR_WEIGHT)) * share[column]


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def _normalise(semantics):  # type: ignore[no-untyped-def]
    steps, classes, cells = semantics.shape
    if not classes:
        return
    total = np.empty(cells, np.float32)
    for step in range(steps):
        total[:] = 0.0
        for k in range(classes):
            for cell in range(cells):
                total[cell] += semantics[step, k, cell]
        for cell in range(cells):
            total[cell] = np.float32(1.0) / total[cell]
        for k in range(classes):
            for cell in range(cells):
                semantics[step, k, cell] *= total[cell]
