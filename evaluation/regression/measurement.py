"""A measurement: what one run counted for each tracker, recording, unit, stratum and step band; small enough for git.

A baseline is the measurements of one or several earlier runs, in a file.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated, Any, Final, Literal

from pydantic import Field, model_validator

from gridtrack.common.config import Settings
from gridtrack.common.errors import GridtrackError

BASELINE_SCHEMA: Final = 2
BANDS: dict[str, tuple[float, float]] = {"short": (0.0, 0.5), "middle": (0.5, 1.5), "long": (1.5, 3600.0)}
"""Horizons of each step band in seconds, the first excluded: step 0 on visible cells is copying."""
BLOCK_S = 100.0
"""Where the recordings are too few to be the units, these are blocks of at least this time: longer than people
linger, and than most signals' cycles; where a place has a longer cycle, that long."""

Name = Annotated[str, Field(min_length=1, max_length=200)]
Count = Annotated[int, Field(ge=0, le=2**53)]
Milliseconds = Annotated[float, Field(gt=0.0, le=1e9)]
BandCounts = tuple[Count, Count, Count, Count, Annotated[float, Field(ge=0.0)]]
"""TP, FP, FN, TN at the thresholds that were in use, and the sum of the log loss in nats."""


class Unmeasured(GridtrackError):
    """A comparison that cannot be made: it neither passes nor is anything worse. `reasons` holds one line for each."""

    def __init__(self, reasons: Sequence[str]) -> None:
        super().__init__("; ".join(reasons))
        self.reasons = tuple(reasons)


class SplitKey(Settings):
    """What must be equal on a recording for the frames and thresholds of two runs to pair."""

    sha256: str
    stretch_s: tuple[float, float | None]
    grid: str
    rate_hz: float
    horizons_s: Annotated[tuple[float, ...], Field(min_length=2, max_length=10_000)]
    warm_up_frames: int
    forecast_every_frames: int
    validation_s: tuple[float, float | None] | None
    validation_sha256: str


class UnitCounts(Settings):
    """The scored frames of one unit: how many, which (`delivered`, a digest of their stamps and what was shown until
    then), and their counts by stratum and step band."""

    frames: Annotated[int, Field(ge=1, le=2**40)]
    delivered: Annotated[str, Field(pattern=r"^[0-9a-f]{32}$")]
    counts: Annotated[dict[Name, dict[Name, BandCounts]], Field(min_length=1, max_length=100)]


class Speed(Settings):
    """Median time of an update and of a forecast, alone on the machine, milliseconds."""

    update_ms: Milliseconds
    predict_ms: Milliseconds


class TrialCounts(Settings):
    """One tracker on one recording; `figures` names what was measured of it beside its scores."""

    weights_sha256: str = ""
    units: Annotated[tuple[UnitCounts, ...], Field(min_length=1, max_length=100_000)]
    speed: Speed | None = None
    figures: tuple[Literal["deadline", "degrade"], ...] = ()


class TrackerCounts(Settings):
    """One tracker with its options, on every recording."""

    tracker: str
    options: dict[str, Any]
    recordings: Annotated[dict[Name, TrialCounts], Field(min_length=1)]


class Measurement(Settings):
    """What a complete run counted. `block_s` is the length of its units in seconds; None: whole recordings."""

    command: tuple[str, ...]
    versions: dict[str, str]
    block_s: Annotated[float, Field(gt=0.0)] | None
    recordings: Annotated[dict[Name, SplitKey], Field(min_length=1)]
    trackers: Annotated[dict[Name, TrackerCounts], Field(min_length=1)]

    @model_validator(mode="after")
    def _every_trial_is_there(self) -> Measurement:
        for label, entry in self.trackers.items():
            if entry.recordings.keys() != self.recordings.keys():
                raise ValueError(
                    f"tracker {label} was not measured on every recording, or on one that is not described"
                )
        return self

    def trials(self) -> Iterator[tuple[str, str, TrialCounts]]:
        """Every trial with its label and recording."""
        for label, entry in self.trackers.items():
            for recording, trial in entry.recordings.items():
                yield label, recording, trial


class Baseline(Settings):
    """What a run is held against: the measurements of one run, or of several, each of a training or a seed of its own.

    Several are of the same trackers with the same options, on the same frames (`pairing.require_comparable`).
    """

    schema_version: Literal[2] = Field(default=BASELINE_SCHEMA, alias="schema")
    runs: Annotated[tuple[Measurement, ...], Field(min_length=1, max_length=100)]

    @property
    def first(self) -> Measurement:
        """Stands for all of them in what they have in common."""
        return self.runs[0]
