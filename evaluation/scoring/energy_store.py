"""The energy store: a Parquet file of a trial with the energy scores of its futures (`results.columns` declares it).

Only a trial whose forecasts have sampled futures has one.
"""

from __future__ import annotations

from pathlib import Path

from gridtrack.evaluation.results.columns import ENERGY_TABLE
from gridtrack.evaluation.scoring.energy import ENERGY_STRATA, EnergyTerms
from gridtrack.evaluation.scoring.store_writer import RowGroups, StoreWriter, row_keys


class EnergyWriter(StoreWriter):
    """Writes one trial's energy scores; without any there is no file."""

    def __init__(self, folder: Path, steps: int) -> None:
        super().__init__(folder)
        self._steps = steps
        self._rows: RowGroups | None = None

    def add(self, stamp_ns: int, terms: EnergyTerms) -> None:
        """Add the terms of the forecast made at `stamp_ns`."""
        if self._rows is None:
            self._rows = self._rows_of(ENERGY_TABLE)
        values = {"forecasts": terms.forecasts, "distance": terms.distance, "spread": terms.spread}
        columns = {name: value.ravel() for name, value in values.items()}
        self._rows.append(row_keys(stamp_ns, self._steps, ENERGY_STRATA) | columns)
