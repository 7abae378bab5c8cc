"""A recording of a run as run.json and summary.json describe it: its stretches, steps, grid and sampling."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated, Self

from pydantic import Field, model_validator

from gridtrack.evaluation.results.values import ResultModel

LONGEST_S, SHORTEST_STEP_S = 3600.0, 1e-5
"""Longest horizon and shortest period that are read, seconds: far beyond those of any comparison."""
StretchSeconds = tuple[float, float | None]
"""Start and end of a stretch, seconds since the start of its recording; None: to the end."""


class RecordingDescription(ResultModel):
    """What was compared on one recording."""

    horizons_s: tuple[Annotated[float, Field(ge=0.0, le=LONGEST_S)], ...] = Field(min_length=2)
    """Of steps 0..n, seconds."""
    stretch: str = ""
    """The test stretch."""
    validation: str = ""
    """The stretch on which thresholds are chosen; empty without one."""
    site: str = ""
    classes: tuple[str, ...] = ()
    """The classes that the recording labels."""
    grid: str = ""
    rate_hz: float | None = None
    frames: int = 0
    """Of the test stretch."""
    warm_up_frames: int = 0
    forecast_every_frames: int = 0
    cycle_s: float | None = None
    """The longest cycle of the place, such as that of its traffic signals, seconds; null where none is known."""
    source_sha256: str = ""
    """Of the file that the recording was imported from, else of its own file. Recordings and stretches of one source
    are one recording for the statistical units; empty: not known, and no other is of the same source."""

    @property
    def period_s(self) -> float:
        """The period of the stream, the time of one step, seconds."""
        return self.horizons_s[1] - self.horizons_s[0]

    @model_validator(mode="after")
    def _horizons_increase(self) -> Self:
        refuse_unordered(self.horizons_s)
        return self


def refuse_unordered(horizons_s: Sequence[float]) -> None:
    """Raise ValueError for horizons that do not increase."""
    if any(later - earlier < SHORTEST_STEP_S for earlier, later in pairwise(horizons_s)):
        raise ValueError("horizons_s do not increase")


class RecordingIdentity(RecordingDescription):
    """What decides the scores on a recording: equal for runs of the same frames, steps and validation stretch."""

    stretch_s: StretchSeconds
    sha256: str
    """Of the recording's file."""
    validation_s: StretchSeconds | None
    validation_sha256: str


class RecordingSummary(RecordingDescription):
    """A recording in summary.json."""

    parity: bool = True
    """Whether every tracker was delivered the same frames: trackers are ranked only where it holds."""
