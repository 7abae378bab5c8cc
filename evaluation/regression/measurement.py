"""The models of a measurement and of a baseline.

A measurement holds the sums of the judged scores of one run for each tracker, recording, statistical unit, stratum and
step band, and is small enough for git. A baseline is the measurements of one or several earlier runs in one file.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from itertools import groupby
from typing import Annotated, Any, Final, Literal

from pydantic import BeforeValidator, Field, PlainSerializer, model_validator

from gridtrack.common.config import Settings
from gridtrack.common.errors import GridtrackError, bounded_line
from gridtrack.trackers.contract import Role

BASELINE_SCHEMA: Final = 4
BANDS: dict[str, tuple[float, float]] = {"short": (0.0, 0.5), "middle": (0.5, 1.5), "long": (1.5, 3600.0)}
"""Horizons of each step band in seconds, above the first and up to the second; step 0, the input frame, is in none."""

Name = Annotated[str, Field(min_length=1, max_length=200)]
WholeNumber = Annotated[int, Field(ge=0, le=2**53)]
Milliseconds = Annotated[float, Field(gt=0.0, le=1e9)]
FiniteSum = Annotated[float, Field(ge=-1e300, le=1e300)]
MOST_PARTS = 10_000
"""A score with more sums is refused."""
_ZEROS = re.compile(r"([0-9]{1,5})\*0")
_BLOCK = re.compile(r"(.+) 0-([0-9]{1,5})")


def _packed_sums(sums: tuple[float, ...]) -> list[Any]:
    """Sums as a file has them: "590*0" stands for 590 zeros, because most bins of a histogram are empty."""
    found: list[Any] = []
    for is_zero, run in groupby(sums, key=lambda one: one == 0):
        own = [int(one) if float(one).is_integer() else one for one in run]
        found += [f"{len(own)}*0"] if is_zero and len(own) > 2 else own
    return found


def _packed_parts(parts: tuple[str, ...]) -> list[str]:
    """Names as a file has them: "contacts 0-9" stands for "contacts 0" to "contacts 9"."""
    found: list[str] = []
    for part in parts:
        name, _, number = part.rpartition(" ")
        earlier = _BLOCK.fullmatch(found[-1]) if found else None
        if earlier and earlier[1] == name and number == str(int(earlier[2]) + 1):
            found[-1] = f"{name} 0-{number}"
        else:
            found.append(f"{name} 0-0" if name and number == "0" else part)
    return found


def _unpacked_sums(packed: Any) -> Any:
    return _unpacked(packed, _ZEROS, lambda run: [0.0] * int(run[1]))


def _unpacked_parts(packed: Any) -> Any:
    return _unpacked(packed, _BLOCK, lambda run: [f"{run[1]} {n}" for n in range(int(run[2]) + 1)])


def _unpacked(packed: Any, pattern: re.Pattern[str], values_of: Callable[[re.Match[str]], list[Any]]) -> Any:
    """A list with all values that each of its texts of this pattern stands for. Raises ValueError above MOST_PARTS."""
    if not isinstance(packed, list | tuple):
        return packed
    found: list[Any] = []
    for one in packed:
        run = pattern.fullmatch(one) if isinstance(one, str) else None
        found += values_of(run) if run else [one]
        if len(found) > MOST_PARTS:
            raise ValueError(f"more than {MOST_PARTS} parts")
    return found


Parts = Annotated[tuple[Name, ...], BeforeValidator(_unpacked_parts), PlainSerializer(_packed_parts, when_used="json")]
PackedSums = Annotated[
    tuple[FiniteSum, ...], BeforeValidator(_unpacked_sums), PlainSerializer(_packed_sums, when_used="json")
]
BandSums = dict[str, PackedSums]
"""By step band the sums of a score, in the order of its parts."""


class Unmeasured(GridtrackError):
    """A comparison that cannot be made: the verdict is neither `worse` nor `no worse`. `reasons`: one line each."""

    def __init__(self, reasons: Sequence[str]) -> None:
        super().__init__("; ".join(reasons))
        self.reasons = tuple(map(bounded_line, reasons))


class SplitKey(Settings):
    """The settings and hashes of a recording. Two runs pair only if all of them are equal."""

    sha256: str
    source_sha256: str
    stretch_s: tuple[float, float | None]
    grid: str
    rate_hz: float
    horizons_s: Annotated[tuple[float, ...], Field(min_length=2, max_length=10_000)]
    warm_up_frames: int
    forecast_every_frames: int
    validation_s: tuple[float, float | None] | None
    validation_sha256: str


class UnitSums(Settings):
    """The scored frames of one recording in one statistical unit.

    `unit` numbers the units of all recordings: recordings of one source may share a unit. `delivered` is a digest of
    the stamps of the scored frames and of all frames delivered before them; `sums` are by score, stratum and step band.
    """

    unit: Annotated[int, Field(ge=0, le=2**40)]
    frames: Annotated[int, Field(ge=1, le=2**40)]
    delivered: Annotated[str, Field(pattern=r"^[0-9a-f]{32}$")]
    sums: Annotated[dict[Name, dict[Name, BandSums]], Field(min_length=1, max_length=100)]


class Speed(Settings):
    """Median times of an update and of a forecast, milliseconds, of a tracker that runs alone on the machine."""

    update_ms: Milliseconds
    predict_ms: Milliseconds


class MeasuredTrial(Settings):
    """One tracker on one recording: its units in the order of time, and its other measurements."""

    weights_sha256: str = ""
    units: Annotated[tuple[UnitSums, ...], Field(min_length=1, max_length=100_000)]
    recoveries: WholeNumber = 0
    """Number of failures inside the tracker after which it continued, by its own count."""
    speed: Speed | None = None
    deadline_rates: tuple[float, ...] = ()
    """The rates of the pass on a simulated clock, as multiples of the stream's rate."""
    degradations: dict[Name, tuple[float, ...]] = Field(default_factory=dict)
    """The scored values of each kind of degraded input."""


class TrackerSums(Settings):
    """One tracker with its options, on every recording."""

    tracker: str
    role: Role = "tracker"
    """As the tracker declares it."""
    options: dict[str, Any]
    points: str = "centres"
    """The returns in each frame: `centres` of occupied cells, or `raw`."""
    program: tuple[str, ...] = ()
    """The program without its folder, and its arguments."""
    seed: int = 0
    recordings: Annotated[dict[Name, MeasuredTrial], Field(min_length=1)]


class Measurement(Settings):
    """The sums of a complete run. `block_s`: length of a unit in seconds; None: the units are whole recordings.
    `scores`: the parts of each judged score."""

    command: tuple[str, ...]
    versions: dict[str, str]
    scoring_rules: int = 1
    """The `SCORING_RULES` of the run."""
    block_s: Annotated[float, Field(gt=0.0)] | None
    scores: dict[Name, dict[Name, Parts]]
    """By label and score."""
    recordings: Annotated[dict[Name, SplitKey], Field(min_length=1)]
    trackers: Annotated[dict[Name, TrackerSums], Field(min_length=1)]

    @model_validator(mode="after")
    def _sums_have_their_parts(self) -> Measurement:
        for label, recording, trial in self.trials():
            parts = self.scores.get(label, {})
            for unit in trial.units:
                for score, strata in unit.sums.items():
                    expected = len(parts.get(score, ()))
                    if any(len(sums) != expected for bands in strata.values() for sums in bands.values()):
                        raise ValueError(f"{label}@{recording}: sums of {score} that are not {expected}")
        return self

    @model_validator(mode="after")
    def _every_tracker_has_every_recording(self) -> Measurement:
        for label, entry in self.trackers.items():
            if entry.recordings.keys() != self.recordings.keys():
                raise ValueError(
                    f"tracker {label} was not measured on every recording, or on one that is not described"
                )
        return self

    def trials(self) -> Iterator[tuple[str, str, MeasuredTrial]]:
        """Every trial with its label and recording."""
        for label, entry in self.trackers.items():
            for recording, trial in entry.recordings.items():
                yield label, recording, trial


class Baseline(Settings):
    """The measurements of one earlier run, or of several runs with other trainings or seeds.

    Several runs have the same trackers, options and frames (`pairing.require_comparable`).
    """

    schema_version: Literal[4] = Field(default=BASELINE_SCHEMA, alias="schema")
    digest: str
    """SHA-256 of `runs`; it shows a change by hand."""
    history: str = ""
    """Digest of the newest entry of the history when the baseline was written; it shows if that entry is removed."""
    runs: Annotated[tuple[Measurement, ...], Field(min_length=1, max_length=100)]

    @property
    def first(self) -> Measurement:
        """The first run: trackers, options, recordings and rules are equal in all runs."""
        return self.runs[0]
