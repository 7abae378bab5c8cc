"""The prior: a tracker's expectation of a place before its first frame, beside the recording."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import parquet

from gridtrack.common.files import atomic_write
from gridtrack.common.grid import GridFrame
from gridtrack.evaluation.referee.referee import Moment, TrackerLike
from gridtrack.evaluation.runs.plan import Trial

PRIOR_FILE = "prior.parquet"
PRIOR_COLUMNS: dict[str, tuple[Any, str]] = {
    "row": (pa.int16(), "of the cell"),
    "column": (pa.int16(), "of the cell"),
    "visible": (pa.int32(), "frames of the test stretch in which the cell is visible"),
    "occupied": (pa.int32(), "frames of the test stretch in which it is occupied"),
    "probability": (pa.float32(), "P(occupied) one step after a first frame that shows nothing"),
}
"""Type and meaning of each column of the prior: a row is a cell of the window, row by row."""


def has_prior(trial: Trial) -> bool:
    """Whether the tracker can expect something of the place.

    A tracker without weights expects nothing, and one with general weights the same everywhere. The window of a sensor
    that moves is no place.
    """
    return trial.weights is not None and not trial.weights.card.general and trial.test.first_move_s is None


class PriorRecorder:
    """The expectation of a tracker that has just started, and the recorded frames in which cells are seen."""

    def __init__(self, tracker: TrackerLike, trial: Trial) -> None:
        """Ask the `tracker` one step after a frame that shows nothing. Raises TrialEnded."""
        tracker.reset(trial.seed)
        tracker.update(without_returns(next(iter(trial.test))))
        self._probability = tracker.predict(1).occupancy[1].copy()  # without the rest of the forecast
        self._visible, self._occupied = (np.zeros(trial.test.grid.shape, np.int32) for _ in range(2))

    def counted(self, moments: Iterable[Moment]) -> Iterator[Moment]:
        """The `moments` of the test stretch, each counted."""
        for moment in moments:
            self._visible += moment.frame.visible
            self._occupied += moment.frame.occupied
            yield moment

    def write(self, folder: Path) -> None:
        """Write the table. Raises OSError."""
        row, column = np.indices(self._visible.shape, np.int16)
        columns = (row, column, self._visible, self._occupied, self._probability)
        schema = pa.schema([(name, kind) for name, (kind, _) in PRIOR_COLUMNS.items()])
        table = pa.table([values.ravel() for values in columns], schema=schema)
        with atomic_write(folder / PRIOR_FILE) as file:
            parquet.write_table(table, file, compression="zstd")


def without_returns(frame: GridFrame) -> GridFrame:
    """A frame of the same sensors in which no cell is visible."""
    nothing = np.zeros_like(frame.visible)
    return replace(
        frame, visible=nothing, occupied=nothing, points=frame.points[:0], point_origin=frame.point_origin[:0]
    )
