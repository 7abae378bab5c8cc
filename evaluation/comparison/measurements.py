"""The figures that a run is asked for beside its scores, and which of them a trial has to show."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

from gridtrack.evaluation.scoring.record import TrialRecord
from gridtrack.recordings.degradation import Degradation


class RequestedMeasurements(Protocol):
    """What `compare` was asked for with `--latency`, `--deadline` and `--degrade`."""

    @property
    def latency(self) -> bool:
        """Whether to time each tracker alone."""

    @property
    def deadline(self) -> bool:
        """Whether to score on a simulated clock."""

    @property
    def degrade(self) -> Degradation | None:
        """What input to score on beside the undegraded one."""


def missing_measurements(asked: RequestedMeasurements, record: TrialRecord) -> Iterator[str]:
    """A line for each figure that was asked for and is not in the record of a complete trial."""
    there = {
        "--latency": not asked.latency or record.latency_ms is not None,
        "--deadline": not asked.deadline or record.deadline is not None,
        "--degrade": asked.degrade is None
        or (record.robustness is not None and record.robustness.degradation == asked.degrade),
    }
    for option in (option for option, measured in there.items() if not measured):
        yield (
            f"{record.label}@{record.recording}: {option} was asked for and failed (why: `notices` in summary.json):"
            " compare again with --resume"
        )
