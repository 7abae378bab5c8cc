"""The prior pass: a tracker's expectation of a place before its first frame, beside the recording."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import parquet

from gridtrack.common.files import atomic_write
from gridtrack.common.grid import GridFrame
from gridtrack.evaluation.runs.plan import Trial
from gridtrack.evaluation.runs.trial_record import TrialRecord

PRIOR_LOG = "prior.log"
PRIOR_FILE = "prior.parquet"
PRIOR_COLUMNS: dict[str, tuple[Any, str]] = {
    "row": (pa.int16(), "of the cell"),
    "column": (pa.int16(), "of the cell"),
    "visible": (pa.int32(), "frames of the test stretch in which the cell is visible"),
    "occupied": (pa.int32(), "frames of the test stretch in which it is occupied"),
    "probability": (pa.float32(), "P(occupied) one step after a first frame that shows nothing"),
}
"""Type and meaning of each column of the prior: a row is a cell of the window, row by row."""


def trials_with_priors(trials: Iterable[Trial], records: Mapping[str, TrialRecord]) -> list[Trial]:
    """The complete `trials` with a prior to measure: of each row the first at each place.

    A tracker without weights expects nothing of a place, and one with general weights the same everywhere. The window
    of a sensor that moves is no place.
    """
    first: dict[tuple[str, str, str], Trial] = {}
    for trial in trials:
        if trial.weights and not trial.weights.card.general and trial.test.first_move_s is None:
            first.setdefault((trial.label, trial.test.site, str(trial.test.grid)), trial)
    return [trial for trial in first.values() if PRIOR_FILE not in records[trial.name].files]


class PriorRun:
    """The prior of one trial, from a fresh process: one that has seen the stream could remember it."""

    def __init__(self, trial: Trial, folder: Path) -> None:
        """The log of the process and the table go to `folder`."""
        self._trial, self._folder = trial, folder
        self._process = trial.tracker_process(folder / PRIOR_LOG)

    def run(self, on_frame: Callable[[], None]) -> None:
        """Write the table; `on_frame` is called before each frame and may raise to end it. Raises TrialEnded."""
        visible, occupied = (np.zeros(self._trial.test.grid.shape, np.int32) for _ in range(2))
        nothing: GridFrame | None = None
        for frame in self._trial.test:
            on_frame()
            visible += frame.visible
            occupied += frame.occupied
            nothing = nothing or without_returns(frame)
        assert nothing is not None, "a complete trial has frames"
        with self._process as process:
            process.reset(self._trial.seed)
            process.update(nothing)
            probability = process.predict(1).occupancy[1]
        write_prior(self._folder, visible, occupied, probability)

    def interrupt(self) -> None:
        """End the pass from another thread, also during a call."""
        self._process.kill()


def without_returns(frame: GridFrame) -> GridFrame:
    """A frame of the same sensors in which no cell is visible."""
    nothing = np.zeros_like(frame.visible)
    return replace(
        frame, visible=nothing, occupied=nothing, points=frame.points[:0], point_origin=frame.point_origin[:0]
    )


def write_prior(
    folder: Path, visible: NDArray[np.int32], occupied: NDArray[np.int32], probability: NDArray[np.float32]
) -> None:
    """Write the frames (M, M) in which each cell is visible and occupied, and its expected probability (M, M)."""
    row, column = np.indices(visible.shape, np.int16).reshape(2, -1)
    cells = (row, column, *(values.ravel() for values in (visible, occupied, probability)))
    schema = pa.schema([(name, kind) for name, (kind, _) in PRIOR_COLUMNS.items()])
    with atomic_write(folder / PRIOR_FILE) as file:
        parquet.write_table(pa.table(list(cells), schema=schema), file, compression="zstd")
