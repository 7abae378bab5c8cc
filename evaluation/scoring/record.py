"""The record of a trial: outcome.json, written when it ends, read by the summary and by a resumed run."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, Self

from pydantic import Field, ValidationError

from gridtrack.common.config import Settings
from gridtrack.common.errors import GridtrackError
from gridtrack.evaluation.processes.outcome import Outcome
from gridtrack.evaluation.scoring.thresholds import Thresholds
from gridtrack.recordings.degradation import Degradation
from gridtrack.trackers.contract import ComparedPart, Role

SCHEMA = 1
RECORD = "outcome.json"
MAX_BYTES = 1 << 24

Ending = Outcome | Literal["interrupted", "failed"]
"""How a trial ended; `interrupted` where the run was, `failed` where not the tracker but the scoring of it did."""


class RunError(GridtrackError):
    """A run's folder that cannot be used."""


class ThresholdsUsed(Settings):
    """Per stratum the threshold of each step, and the stretch they were chosen on; all 0.5 where that is empty."""

    values: dict[str, tuple[float, ...]] = Field(default_factory=dict)
    chosen_on: str = ""

    @classmethod
    def of(cls, thresholds: Thresholds) -> Self:
        """As they are kept in a record."""
        columns = thresholds.values.T.tolist()
        values = dict(zip(thresholds.strata, map(tuple, columns), strict=True))
        return cls(values=values, chosen_on=thresholds.chosen_on)


class Times(Settings):
    """Where a trial's time went, in seconds, over both stretches.

    The tracker's own in `update` and `predict`, by its clock; `start_s` until it was ready; `wall_s` from the first of
    the `frames` delivered to the last, the tracker's own time included.
    """

    start_s: float = 0.0
    update_s: float = 0.0
    predict_s: float = 0.0
    wall_s: float = 0.0
    frames: int = 0


class Quantiles(Settings):
    """Milliseconds."""

    p50: float
    p95: float
    p99: float


class Latency(Settings):
    """What an update, a forecast, and one step of a forecast take, by the tracker's own clock, alone on the machine."""

    update: Quantiles
    predict: Quantiles
    predict_step: Quantiles


Curves = dict[str, tuple[float | None, ...]]
"""Per stratum one value for each step; None where it is not defined."""


class AtRate(Settings):
    """A trial scored on the clock, its frames coming at `rate` times their own rate.

    `missed` of the `frames` were not given to the tracker; `age_frames`: how many frames old the newest forecast was.
    """

    rate: float
    rate_hz: float
    frames: int
    missed: int
    age_frames: Quantiles
    f1: Curves


class Deadline(Settings):
    """A trial on a simulated clock: what its calls take alone on the machine, and what it scores in time.

    `busy_ms`: an update and the forecast after it, which goes `forecast_steps` ahead; `highest_rate_hz`: where 99 of
    100 frames are done before the next one comes.
    """

    update_ms: Quantiles
    predict_ms: Quantiles
    busy_ms: Quantiles
    highest_rate_hz: float
    forecast_steps: int
    rates: tuple[AtRate, ...]


class AtStrength(Settings):
    """A trial whose tracker was shown degraded frames: at `strength` of what was asked for, which is `value`.

    `delivered`: hash of the degraded frames. F1 is of the undegraded ones.
    """

    strength: float
    value: float
    delivered: str
    f1: Curves


class Robustness(Settings):
    """F1 under each kind of `degradation` by itself, by its strength."""

    degradation: Degradation
    kinds: dict[str, tuple[AtStrength, ...]]


class TrialRecord(Settings):
    """One trial: how it ended, how far it came, and what it ran on."""

    schema_version: int = Field(default=SCHEMA, alias="schema")
    label: str
    recording: str
    outcome: Ending
    reason: str = ""
    frames_scored: int = 0
    frames_expected: int = 0
    frames_delivered: int = 0
    delivered: str = ""
    """Hash of every frame delivered, in their order."""
    steps: int
    thresholds: ThresholdsUsed = ThresholdsUsed()
    classes: tuple[str, ...] = ()
    """What the tracker gives probabilities for."""
    role: Role = "tracker"
    reference_for: tuple[ComparedPart, ...] = ()
    """The comparisons in which the other rows are compared with this tracker by default."""
    weights_sha256: str = ""
    recoveries: int = 0
    """How often something in the tracker failed and it went on from what was sound, by its own count."""
    times: Times = Times()
    peak_rss_mb: float | None = None
    latency_ms: Latency | None = None
    deadline: Deadline | None = None
    robustness: Robustness | None = None

    def write(self, folder: Path) -> None:
        """Leave it in a trial's folder, replaced whole."""
        partial = folder / (RECORD + ".partial")
        partial.write_text(self.model_dump_json(by_alias=True, indent=1) + "\n")
        partial.replace(folder / RECORD)


def read_record(folder: Path) -> TrialRecord | None:
    """The record in a trial's folder; None where the trial has not ended. Raises RunError."""
    path = folder / RECORD
    try:
        if path.stat().st_size > MAX_BYTES:
            raise RunError(f"{path}: {path.stat().st_size} bytes; more than {MAX_BYTES} are refused")
        record = TrialRecord.model_validate_json(path.read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, ValidationError) as error:
        reason = str(error).splitlines()[0]
        raise RunError(f"{path}: not a trial's record of gridtrack ({reason}); delete the folder") from None
    if record.schema_version != SCHEMA:
        raise RunError(f"{path}: schema {record.schema_version}; this gridtrack reads {SCHEMA}: run it again")
    return record
