"""How a trial ended: one word that a table can count, and one line that says why."""

from __future__ import annotations

from typing import Literal, get_args

from gridtrack.common.errors import GridtrackError

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
    """A trial that cannot go on: its `outcome`, and the `reason` in one line."""

    def __init__(self, outcome: Outcome, reason: str) -> None:
        super().__init__(f"{outcome}: {reason}")
        self.outcome = outcome
        self.reason = reason
