"""A progress display for comparisons that a study starts itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from gridtrack.evaluation.runs.trial_record import TrialRecord


class NoProgress:
    """A progress display that shows nothing."""

    def note(self, text: str) -> None:
        """Show nothing."""

    def planned(self, frames: Mapping[str, int], then: Sequence[str] = ()) -> None:
        """Show nothing."""

    def started(self, trial: str, frames: int) -> None:
        """Show nothing."""

    def advanced(self, trial: str) -> None:
        """Show nothing."""

    def ended(self, trial: str, record: TrialRecord) -> None:
        """Show nothing."""
