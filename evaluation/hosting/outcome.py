"""The outcome of a trial: one of a few words, with a reason in one line."""

from __future__ import annotations

from typing import Literal, get_args

from gridtrack.common.errors import GridtrackError, bounded_line

Outcome = Literal[
    "ok",
    "crashed",
    "timeout",
    "out-of-memory",
    "invalid-output",
    "unavailable",
    "untrained",
    "not-applicable",
]
OUTCOMES: tuple[Outcome, ...] = get_args(Outcome)


class TrialEnded(GridtrackError):
    """A trial that cannot continue: its `outcome`, and the `reason` in one line."""

    def __init__(self, outcome: Outcome, reason: str) -> None:
        super().__init__(f"{outcome}: {reason}")
        self.outcome = outcome
        self.reason = bounded_line(reason)
