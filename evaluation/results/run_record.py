"""run.json: the resolved configuration of a run, its inputs and their hashes, versions, machine and status."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final, Literal

from pydantic import ConfigDict, Field

from gridtrack.evaluation.results.files import read_model, write_model
from gridtrack.evaluation.results.recording import RecordingIdentity
from gridtrack.evaluation.results.values import ResultModel
from gridtrack.recordings.degradation import Degradation

RUN_SCHEMA: Final = 2
RUN_FILE = "run.json"
MAX_RUN_BYTES = 1 << 24

RunStatus = Literal["running", "complete", "interrupted"]


class TrialIdentity(ResultModel):
    """What decides a trial's scores beside its recording and its weights."""

    tracker: str
    options: dict[str, Any]
    """As given; what is not given has the tracker's default."""
    points: str = "centres"
    """The returns in each frame: `centres` of occupied cells, or `raw`."""
    argv: tuple[str, ...] = ()
    """The command that starts the tracker; of a built-in tracker without the interpreter."""
    seed: int = 0
    threads: int = 1


class RunConfiguration(ResultModel):
    """The resolved configuration: a resumed run must have the same."""

    scoring_rules: int = 1
    """The `SCORING_RULES` by which it is scored."""
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
    """Labelled scans that their classes were learned from; null where there are no classes, and in an earlier run."""


class Machine(ResultModel):
    """The machine as far as it affects a latency; no name and no address."""

    cpu: str
    cores: int
    """That the run could use."""
    memory_gb: float
    system: str


class RunRecord(ResultModel):
    """A run: what was requested, with which inputs and versions, and how far it is."""

    schema_version: Literal[2] = Field(default=RUN_SCHEMA, alias="schema")
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
    """The record in a run's folder. Raises FileNotFoundError where it has none, and RunError."""
    remedy = "compare again, into another folder (--out)"
    return read_model(folder / RUN_FILE, RunRecord, RUN_SCHEMA, MAX_RUN_BYTES, remedy)
