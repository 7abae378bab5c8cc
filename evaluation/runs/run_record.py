"""run.json: the resolved configuration of a run, its inputs and their hashes, versions, machine and status."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

from pydantic import ConfigDict, Field, model_validator

from gridtrack.evaluation.referee.splits import EvaluationSplit
from gridtrack.evaluation.runs.result_files import ResultModel, read_model, write_model
from gridtrack.evaluation.scores.robot import SMALL_ROBOT, Robot
from gridtrack.recordings.degradation import Degradation

RUN_SCHEMA: Final = 3
RUN_FILE = "run.json"
MAX_RUN_BYTES = 1 << 24

RunStatus = Literal["running", "complete", "interrupted"]


LONGEST_S, SHORTEST_STEP_S = 3600.0, 1e-5
"""Longest horizon and shortest period that are read, seconds: far beyond any comparison."""
StretchSeconds = tuple[float, float | None]
"""Start and end of a stretch, seconds since the start of its recording; None: to the end."""


class RecordingDescription(ResultModel):
    """The comparison on one recording."""

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
    """The longest cycle of the place, such as the cycle of its traffic signals, seconds; null if none is known."""
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
    """Everything that decides the scores on a recording: equal for runs of the same frames, steps and validation."""

    stretch_s: StretchSeconds
    sha256: str
    """Of the recording's file."""
    validation_s: StretchSeconds | None
    validation_sha256: str


def description_of(split: EvaluationSplit) -> RecordingDescription:
    """A recording of a comparison as the summary describes it."""
    return RecordingDescription(**_described(split))


def identity_of(split: EvaluationSplit) -> RecordingIdentity:
    """The values that decide the scores on a recording: a resumed run must have the same."""
    validation = split.validation
    return RecordingIdentity(
        **_described(split),
        stretch_s=split.test.stretch_s,
        sha256=split.test.sha256,
        validation_s=validation.stretch_s if validation else None,
        validation_sha256=validation.sha256 if validation else "",
    )


def _described(split: EvaluationSplit) -> dict[str, Any]:
    """The fields of RecordingDescription."""
    test = split.test
    return {
        "horizons_s": tuple(round(step * test.period_s, 6) for step in range(split.steps + 1)),
        "stretch": test.name,
        "validation": split.validation.name if split.validation else "",
        "site": test.site,
        "classes": tuple(test.classes),
        "grid": str(test.grid),
        "rate_hz": round(1 / test.period_s, 6),
        "frames": len(test),
        "warm_up_frames": split.warm_up,
        "forecast_every_frames": split.every,
        "cycle_s": test.recording.info.cycle_s,
        "source_sha256": test.recording.source_sha256,
    }


class RecordingSummary(RecordingDescription):
    """A recording in summary.json."""

    parity: bool = True
    """Whether every tracker was delivered the same frames: trackers are ranked only if it holds."""


class TrialIdentity(ResultModel):
    """Everything that decides a trial's scores beside its recording and its weights."""

    tracker: str
    options: dict[str, Any]
    """As given; other options have the tracker's default."""
    points: str = "centres"
    """The returns in each frame: `centres` of occupied cells, or `raw`."""
    argv: tuple[str, ...] = ()
    """The command that starts the tracker; of a built-in tracker without the interpreter."""
    seed: int = 0
    threads: int = 1
    file_sha256: str = ""
    """Of the file of recorded forecasts; empty for a tracker."""


class RunConfiguration(ResultModel):
    """The resolved configuration: a resumed run must have the same."""

    scoring_rules: int = 1
    """The `SCORING_RULES` by which it is scored."""
    robot: Robot = SMALL_ROBOT
    """The virtual robot of contact foresight."""
    recordings: dict[str, RecordingIdentity]
    trials: dict[str, TrialIdentity]
    """By name: LABEL@RECORDING."""


class RunSettings(ResultModel):
    """The settings of `compare` as given: the requested measurements, and every other setting by its name."""

    model_config = ConfigDict(extra="allow")

    latency: bool = False
    deadline: bool = False
    degrade: Degradation | None = None


class WeightsUsed(ResultModel):
    """Learned weights of a trial: their card's name, without folders of the machine, and its hash."""

    name: str
    sha256: str
    labelled_scans: int | None = None
    """Labelled scans that their classes were learned from; null if there are no classes, and in an earlier run."""


class Machine(ResultModel):
    """The machine as far as it affects a latency; no name and no address."""

    cpu: str
    cores: int
    """That the run could use."""
    memory_gb: float
    system: str


class RunRecord(ResultModel):
    """A run: its request, inputs, versions and progress."""

    schema_version: Literal[3] = Field(default=RUN_SCHEMA, alias="schema")
    command: tuple[str, ...]
    """The command line."""
    settings: RunSettings = RunSettings()
    configuration: RunConfiguration
    inputs: dict[str, str] = Field(default_factory=dict)
    """SHA-256 of each recording, by its path."""
    weights: dict[str, WeightsUsed] = Field(default_factory=dict)
    """By trial."""
    versions: dict[str, str] = Field(default_factory=dict)
    """Of Python and of every distribution that can change a score."""
    machine: Machine | None = None
    started: str = ""
    """UTC, ISO 8601."""
    status: RunStatus
    finished: str | None = None
    """UTC, ISO 8601; null while the run goes on."""

    def write(self, folder: Path) -> None:
        """Write it into the run's folder. Raises OSError."""
        write_model(folder / RUN_FILE, self)


def read_run_record(folder: Path) -> RunRecord:
    """The record in a run's folder. Raises FileNotFoundError if it has none, and RunError."""
    remedy = "compare again, into another folder (--out)"
    return read_model(folder / RUN_FILE, RunRecord, RUN_SCHEMA, MAX_RUN_BYTES, remedy)
