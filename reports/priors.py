"""The expectation of trackers for a place before their first frame, and the recorded occupancy, packed for the page.

A plane is M x M bytes, rows from the bottom up, deflated, as base64: the logarithm of a probability from LEAST to 1 in
PRIOR_LEVELS steps, 0 for LEAST and below, and NEVER_SEEN for a cell that was never visible.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyarrow import ArrowException, parquet

from gridtrack.common.grid import GridSpec
from gridtrack.evaluation.runs.prior import PRIOR_COLUMNS, PRIOR_FILE
from gridtrack.reports.run import ReportedRun, ReportError
from gridtrack.reports.table import HeadlineTable

LEAST = 1e-3
"""Lower probabilities are shown as this one, as in the log loss."""
PRIOR_LEVELS, NEVER_SEEN = 254, 255


@dataclass(frozen=True)
class PriorOfPlace:
    """`probability` (M, M) in [0, 1], a tracker's; `recorded` (M, M): the occupied share, NaN if never visible."""

    probability: NDArray[np.float32]
    recorded: NDArray[np.float32]


def priors_of(
    runs: Sequence[ReportedRun], tables: Sequence[HeadlineTable], styles: Mapping[str, str]
) -> tuple[tuple[dict[str, Any], ...], tuple[str, ...]]:
    """The priors of each place for the page of one run, each row's from its first recording there; and notices of
    unreadable files."""
    if len(runs) > 1:
        return (), ()
    (run,) = runs
    places: list[dict[str, Any]] = []
    notices: list[str] = []
    shown: set[tuple[str, str, str]] = set()
    for table in (table for table in tables if not table.pooled):
        described = run.summary.recordings[table.recording]
        found: dict[str, PriorOfPlace] = {}
        for row in table.rows:
            path = run.trial_folder(row.label, table.recording) / PRIOR_FILE
            place = row.label, described.site, described.grid
            if place not in shown and path.is_file():
                try:
                    found[row.label] = read_prior(path, GridSpec.parse(described.grid).size)
                    shown.add(place)
                except ReportError as error:
                    notices.append(str(error))
        if found:
            recorded = next(iter(found.values())).recorded
            rows = [
                {
                    "name": row.name,
                    "label": row.label,
                    "style": styles[row.label],
                    "cells": pack(found[row.label].probability),
                }
                for row in table.rows
                if row.label in found
            ]
            places.append(
                {"recording": table.recording, "size": len(recorded), "recorded": pack(recorded), "rows": rows}
            )
    return tuple(places), tuple(notices)


def read_prior(path: Path, size: int) -> PriorOfPlace:
    """The prior of a trial on a grid of `size` cells a side. Raises ReportError."""
    try:
        with parquet.ParquetFile(path) as file:
            rows = file.metadata.num_rows
            table = file.read(columns=list(PRIOR_COLUMNS)) if rows == size**2 else None
    except (ArrowException, OSError) as error:
        raise ReportError(f"{path}: cannot be read as a prior ({str(error).splitlines()[0]}); run it again") from None
    if table is None or not _is_of_grid(columns := [table.column(name).to_numpy() for name in PRIOR_COLUMNS], size):
        raise ReportError(f"{path}: not the prior of a grid of {size} x {size} cells; run it again")
    _, _, visible, occupied, probability = columns
    with np.errstate(invalid="ignore"):
        recorded = (occupied / visible).astype(np.float32)
    return PriorOfPlace(probability.astype(np.float32).reshape(size, size), recorded.reshape(size, size))


def _is_of_grid(columns: Sequence[NDArray[Any]], size: int) -> bool:
    """Whether the columns have every cell of the grid in order, with possible counts and probabilities."""
    row, column, visible, occupied, probability = columns
    expected = np.indices((size, size)).reshape(2, -1)
    in_order = (row == expected[0]).all() and (column == expected[1]).all()
    possible = (probability >= 0) & (probability <= 1) & (occupied >= 0) & (occupied <= visible)
    return bool(in_order and possible.all())


def pack(probability: NDArray[np.float32]) -> str:
    """A plane (M, M) of probabilities, NaN if the cell was never visible."""
    levels = np.rint(PRIOR_LEVELS * (1.0 - np.log(np.clip(probability, LEAST, 1.0)) / np.log(LEAST)))
    plane = np.where(np.isnan(probability), NEVER_SEEN, np.nan_to_num(levels)).astype(np.uint8)
    return base64.b64encode(zlib.compress(plane.tobytes(), 9)).decode()
