"""The flow store: a Parquet file of a trial with the errors of its velocities (`results.columns` declares it).

Only a trial on a recording with ground truth whose forecasts have velocities has one.
"""

from __future__ import annotations

from pathlib import Path

from gridtrack.evaluation.results.columns import FLOW_TABLE
from gridtrack.evaluation.scoring.flow_errors import FLOW_STRATA, FlowErrors, flow_errors
from gridtrack.evaluation.scoring.referee import ScoredForecast
from gridtrack.evaluation.scoring.store_writer import RowGroups, StoreWriter, row_keys


class FlowWriter(StoreWriter):
    """Writes one trial's flow errors, from its first forecast with velocities on."""

    def __init__(self, folder: Path, steps: int) -> None:
        super().__init__(folder)
        self._steps = steps
        self._rows: RowGroups | None = None
        self._without_ns: list[int] = []

    def add(self, scored: ScoredForecast) -> None:
        """Score the velocities of a forecast."""
        velocity = scored.forecast.velocity
        if self._rows is None:
            if velocity is None:
                self._without_ns.append(scored.stamp_ns)
                return
            self._rows = self._rows_of(FLOW_TABLE)
            for stamp_ns in self._without_ns:
                self._write(self._rows, stamp_ns, FlowErrors.none(self._steps))
        errors = flow_errors(velocity, scored.targets, scored.region_maps, scored.ages)
        self._write(self._rows, scored.stamp_ns, errors)

    def _write(self, rows: RowGroups, stamp_ns: int, errors: FlowErrors) -> None:
        sums = {name: getattr(errors, name).ravel() for name in ("cells", "given", "error", "speed")}
        rows.append(row_keys(stamp_ns, self._steps, FLOW_STRATA) | sums)
