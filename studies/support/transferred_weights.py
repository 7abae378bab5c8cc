"""Weights of a tracker at another site: a copy of its card, with the maps of its own site out of reach.

A comparison never does this of itself: it takes the weights of a recording's site. For recordings of places that no
tracker has learned from, a study copies a card under the name of that site. Its maps lie far away in the world, so that
every cell has what the tracker assumes outside a map.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import GridSpec
from gridtrack.trackers.card import Card
from gridtrack.trackers.model_free.residence import table_shape
from gridtrack.trackers.weights import read_arrays, read_card, save_weights

ELSEWHERE_M = 1e6
"""Distance of the maps from the origin of the world; no recording of a study goes there."""


def transfer(card_path: Path, site: str, period_s: float, folder: Path, *, tuned: bool = True) -> Path:
    """Copy a card and its arrays to `folder`/TRACKER/SITE.toml, for a stream of this period; returns the new card.

    Settings are those that were tuned at the card's own site, or the tracker's defaults. The life table of a model-free
    tracker is read at the ages and steps of the new period. Raises WeightsError, OSError.
    """
    card = read_card(card_path)
    assert card.period_s is not None  # the card of a site
    arrays = read_arrays(card_path.with_suffix(".safetensors"), card.arrays_sha256)
    if "residence" in arrays:
        arrays["residence"] = residence_at(arrays["residence"], card.period_s, period_s)
    size, cell_m = GridSpec.parse(card.grid).size, GridSpec.parse(card.grid).cell_m
    copied: dict[str, Any] = card.model_dump() | {
        "site": site,
        "grid": str(GridSpec(size, cell_m)),
        "period_s": period_s,
        "world_T_grid": (ELSEWHERE_M, ELSEWHERE_M),
        "settings": card.settings if tuned else {},
    }
    path = folder / card.tracker / f"{site}.toml"
    save_weights(path, Card.model_validate(copied), arrays)
    return path


def residence_at(table: NDArray[np.float32], fitted_s: float, period_s: float) -> NDArray[np.float32]:
    """A life table (A, S) of one period as that of another, by the nearest age and step."""
    ages, steps = table_shape(period_s)
    nearest = np.rint(np.arange(max(ages, steps)) * (period_s / fitted_s)).astype(np.int64)
    rows = np.minimum(nearest[:ages], table.shape[0] - 1)
    columns = np.minimum(nearest[:steps], table.shape[1] - 1)
    return np.ascontiguousarray(table[rows[:, None], columns])
