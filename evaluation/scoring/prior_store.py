"""The prior store: the Parquet file of what a tracker expects of a place, beside what the recording shows there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.results.columns import PRIOR_TABLE
from gridtrack.evaluation.scoring.store_writer import RowGroups


def write_prior(
    folder: Path, visible: NDArray[np.int32], occupied: NDArray[np.int32], probability: NDArray[np.float32]
) -> None:
    """Write the frames (M, M) in which each cell is visible and occupied, and its expected probability (M, M)."""
    row, column = np.indices(visible.shape, np.int16).reshape(2, -1)
    cells = {"visible": visible, "occupied": occupied, "probability": probability}
    with RowGroups(folder, PRIOR_TABLE) as table:
        table.append({"row": row, "column": column, **{name: value.ravel() for name, value in cells.items()}})
