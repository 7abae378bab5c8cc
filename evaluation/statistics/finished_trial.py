"""A finished trial as the statistics read it: its record, its folder of counts, and the tracker that ran."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gridtrack.evaluation.results.trial_record import TrialRecord


@dataclass(frozen=True, slots=True)
class FinishedTrial:
    """A trial that has ended: its record, the folder of its files, its tracker, options and kind of points.

    `chosen_steps`: the steps of its forecasts that are read, in their order; None: all.
    """

    record: TrialRecord
    folder: Path
    tracker: str
    options: Mapping[str, Any]
    points: str
    chosen_steps: tuple[int, ...] | None = None

    @property
    def steps(self) -> list[int]:
        """The steps that are read."""
        return list(range(self.record.steps + 1) if self.chosen_steps is None else self.chosen_steps)

    @property
    def complete(self) -> bool:
        """Whether every forecast was scored."""
        return self.record.complete

    @property
    def comparable(self) -> bool:
        """Whether it is complete, and its weights learned from no frame that it is scored on."""
        return self.complete and not self.record.leak

    @property
    def strata(self) -> tuple[str, ...]:
        """The strata that it was scored in."""
        return tuple(self.record.thresholds.values)


def trials_on(recording: str, trials: Sequence[FinishedTrial]) -> list[FinishedTrial]:
    """The trials of one recording."""
    return [trial for trial in trials if trial.record.recording == recording]
