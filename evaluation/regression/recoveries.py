"""Recoveries: failures inside a tracker after which it continued. Scores alone may not show them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from gridtrack.evaluation.regression.measurement import Baseline, Measurement


@dataclass(frozen=True, slots=True)
class RecoveryRow:
    """Recoveries of one tracker on the baseline's recordings. `baseline`: the largest number in one of its runs."""

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
