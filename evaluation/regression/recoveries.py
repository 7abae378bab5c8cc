"""Recoveries: how often a tracker continued after a failure inside it, which scores alone may not show."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from gridtrack.evaluation.regression.measurement import Baseline, Measurement


@dataclass(frozen=True, slots=True)
class RecoveryRow:
    """Recoveries of one tracker on the baseline's recordings: in the run of the baseline with most of them, and in the
    run."""

    label: str
    baseline: int
    run: int

    @property
    def verdict(self) -> Literal["worse", "no worse"]:
        """More recoveries than in any run of the baseline are worse."""
        return "worse" if self.run > self.baseline else "no worse"


def compare_recoveries(baseline: Baseline, run: Measurement) -> tuple[RecoveryRow, ...]:
    """A row for each tracker that recovered from a failure, in the baseline or in the run."""
    rows = []
    for label in baseline.first.trackers:
        *then, now = (
            sum(side.trackers[label].recordings[name].recoveries for name in baseline.first.recordings)
            for side in (*baseline.runs, run)
        )
        if now or any(then):
            rows.append(RecoveryRow(label, max(then), now))
    return tuple(rows)
