"""The spatial store: two Parquet files of a trial with its sums over neighbourhoods and along beams.

Scores that forgive a forecast that is right but some cells away are computed from them (`results.columns` declares the
columns). Runs of before lack the files.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gridtrack.evaluation.results.columns import AGREEMENT, BEAMS_TABLE, NEIGHBOURHOODS_TABLE, SQUARES
from gridtrack.evaluation.scoring.beam_errors import BEAM_STRATA, BeamErrors
from gridtrack.evaluation.scoring.neighbourhoods import NeighbourhoodSums, neighbourhood_strata
from gridtrack.evaluation.scoring.store_writer import StoreWriter, lists_of_rows, row_keys


class SpatialWriter(StoreWriter):
    """Writes one trial's sums over neighbourhoods and along beams."""

    def __init__(self, folder: Path, steps: int, strata: Sequence[str]) -> None:
        """`strata`: those that the trial is scored in."""
        super().__init__(folder)
        self._steps, self._strata = steps, neighbourhood_strata(strata)
        self._neighbourhoods, self._beams = self._rows_of(NEIGHBOURHOODS_TABLE), self._rows_of(BEAMS_TABLE)

    def add(self, stamp_ns: int, sums: NeighbourhoodSums, errors: BeamErrors) -> None:
        """Add the sums and the errors of the forecast made at `stamp_ns`."""
        rows = row_keys(stamp_ns, self._steps, self._strata)
        for names, values in ((AGREEMENT, sums.agreement), (SQUARES, sums.squares)):
            rows |= {name: values[..., w].ravel().astype(np.float32) for w, name in enumerate(names)}
        self._neighbourhoods.append(rows | {"soft_union": sums.soft_union.ravel().astype(np.float32)})
        rows = row_keys(stamp_ns, self._steps, BEAM_STRATA)
        rows |= {"late_m": errors.late.ravel().astype(np.float32), "early_m": errors.early.ravel().astype(np.float32)}
        counts = errors.counts.reshape(len(rows["step"]), -1)
        row, bins = np.nonzero(counts)
        self._beams.append(rows | lists_of_rows(BEAMS_TABLE, row, len(counts), bin=bins, count=counts[row, bins]))
