"""Measurements that a run may request beside its scores: latency, deadlines, degraded input."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

from gridtrack.evaluation.results.trial_record import TrialRecord
from gridtrack.recordings.degradation import Degradation


class RequestedMeasurements(Protocol):
    """The options `--latency`, `--deadline` and `--degrade` of `compare`."""

    @property
    def latency(self) -> bool:
        """Whether to time each tracker alone."""

    @property
    def deadline(self) -> bool:
        """Whether to score each tracker on a simulated clock."""

    @property
    def degrade(self) -> Degradation | None:
        """The degradation of a second, degraded input; None: no such input."""


def missing_measurements(requested: RequestedMeasurements, record: TrialRecord) -> Iterator[str]:
    """A line for each requested measurement that is missing in the record of a complete trial."""
    present = {
        "--latency": not requested.latency or record.latency_ms is not None,
        "--deadline": not requested.deadline or record.deadline is not None,
        "--degrade": requested.degrade is None
        or (record.robustness is not None and record.robustness.degradation == requested.degrade),
    }
    for option in (option for option, measured in present.items() if not measured):
        yield (
            f"{record.label}@{record.recording}: {option} was requested and failed (reason: `notices` in summary.json):"
            " compare again with --resume"
        )
