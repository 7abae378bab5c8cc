"""outcome.json: the record of one trial, written when it ends."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final, Literal

from pydantic import Field

from gridtrack.common.files import sha256_of
from gridtrack.common.notices import Line
from gridtrack.evaluation.hosting.outcome import Outcome
from gridtrack.evaluation.runs.passes import Deadline, Followed, Latency, Robustness, RoundTrips
from gridtrack.evaluation.runs.result_files import ResultModel, RunError, read_model, write_model
from gridtrack.evaluation.runs.run_record import RunSettings
from gridtrack.evaluation.runs.settings import CompareSettings
from gridtrack.evaluation.scores.thresholds import Thresholds
from gridtrack.trackers.contract import ComparedPart, Role

TRIAL_SCHEMA: Final = 3
OUTCOME_FILE = "outcome.json"
MAX_OUTCOME_BYTES = 1 << 24
MOST_MISSING = 0.1
"""With a larger share of frames without a recorded forecast a trial is partial: the others may be easier."""

TrialEnding = Outcome | Literal["interrupted", "failed"]
"""How a trial ended; `interrupted` with its run, `failed` if the scoring failed and not the tracker."""


class ThresholdsUsed(ResultModel):
    """The threshold of each step, by stratum."""

    values: dict[str, tuple[float, ...]] = Field(default_factory=dict)
    chosen_on: str = ""
    """The validation stretch, or the card; empty if there is neither, and every threshold is 0.5."""

    @classmethod
    def of(cls, thresholds: Thresholds) -> ThresholdsUsed:
        """The thresholds of a trial."""
        return cls(values=thresholds.by_stratum, chosen_on=thresholds.chosen_on)

    def thresholds(self) -> Thresholds:
        """The thresholds as the scores need them."""
        return Thresholds.of(self.values, self.chosen_on)


class Times(ResultModel):
    """Seconds that a trial takes over both stretches."""

    start_s: float = 0.0
    """Until the tracker is ready."""
    update_s: float = 0.0
    """By the tracker's own clock, or the round trip: see `clock` of the latency."""
    predict_s: float = 0.0
    """By the tracker's own clock, or the round trip: see `clock` of the latency."""
    wall_s: float = 0.0
    """From the first frame delivered to the last, the tracker's own time included."""
    frames: int = 0
    """Frames delivered."""


class TrialRecord(ResultModel):
    """One trial: its outcome, number of frames, thresholds and measurements."""

    schema_version: Literal[3] = Field(default=TRIAL_SCHEMA, alias="schema")
    label: str
    recording: str
    outcome: TrialEnding
    reason: Line = ""
    """Why it ended, in one line; empty for `ok`."""
    frames_scored: int = 0
    frames_expected: int = 0
    frames_missing: int = 0
    """Frames without a forecast, of a row of recorded forecasts: they are not scored."""
    frames_delivered: int = 0
    """Of the test stretch."""
    delivered: str = ""
    """Hash of the frames delivered, in their order."""
    steps: int
    """Of a forecast."""
    thresholds: ThresholdsUsed = ThresholdsUsed()
    classes: tuple[str, ...] = ()
    """The classes that the tracker gives probabilities for."""
    role: Role = "tracker"
    """The tracker's word, not checked; `tracker` if it did not start."""
    made_by: Line = ""
    """How recorded forecasts were made, by their file; empty for a tracker."""
    reference_for: tuple[ComparedPart, ...] = ()
    """The comparisons in which the other rows are compared with this tracker by default."""
    code_sha256: str = ""
    """Of the tracker's code: of the loaded files of its package, or of its program. The tracker's word if it sends
    one itself, not checked; empty if it is not known."""
    weights_sha256: str = ""
    """Of the card of the weights used; empty without weights."""
    card: Literal["", "site", "general"] = ""
    """Kind of the weights: `site` or `general`; empty without weights."""
    leak: Line = ""
    """Frames of its test or validation stretch that its weights learned from; empty if none."""
    may_remember: bool = False
    """Whether its tracker could read a file that it kept: it is not one of gridtrack, and had no sandbox."""
    started_before: bool = False
    """Whether such a tracker was started for the trial before, and did not end it."""
    files: dict[str, str] = Field(default_factory=dict)
    """SHA-256 of the trial's other files, by name, when the trial ended."""
    recoveries: int = 0
    """How often the tracker continued after a failure inside it: the tracker's word, not checked."""
    times: Times = Times()
    round_trips: RoundTrips = RoundTrips()
    """Of its calls while it was scored."""
    peak_rss_mb: float | None = None
    """Highest resident memory of the tracker's processes, MiB."""
    latency_ms: Latency | None = None
    deadline: Deadline | None = None
    robustness: Robustness | None = None
    followed: Followed | None = None
    """Of a run with `--follow`."""

    @property
    def complete(self) -> bool:
        """Whether every forecast of the test stretch was scored, but for a share of MOST_MISSING."""
        return self.outcome == "ok" and all_scored(self.frames_scored, self.frames_missing, self.frames_expected)

    def changed_file(self, folder: Path) -> Path | None:
        """The first file in the trial's folder that is not the one that the trial wrote; a file may be missing."""
        for name, sha256 in self.files.items():
            path = folder / Path(name).name
            if path.is_file() and sha256_of(path) != sha256:
                return path
        return None

    def require_own_files(self, folder: Path) -> None:
        """Raise RunError if a file in the trial's folder is not the one that the trial wrote."""
        if changed := self.changed_file(folder):
            raise RunError(
                f"{changed}: changed since the trial wrote it (its sha256 is not the one in {OUTCOME_FILE}): compare"
                " with --resume to score the trial again"
            )

    def write(self, folder: Path) -> None:
        """Write it into the trial's folder. Raises OSError."""
        write_model(folder / OUTCOME_FILE, self)


def all_scored(scored: int, missing: int, expected: int) -> bool:
    """Whether all expected frames were scored, but for missing recorded forecasts, a share of MOST_MISSING at most."""
    return 0 < scored == expected - missing and missing <= MOST_MISSING * expected


def code_differs(*sha256s: str) -> bool:
    """Whether hashes of a tracker's code are of unlike code; one that is not known ("") differs from none."""
    return len(set(sha256s) - {""}) > 1


def hashes_of(folder: Path, names: Iterable[str]) -> dict[str, str]:
    """SHA-256 of those files of a trial's folder that exist, by name. Raises OSError."""
    return {name: sha256_of(folder / name) for name in names if (folder / name).is_file()}


def read_trial_record(folder: Path) -> TrialRecord | None:
    """The record in a trial's folder; None if the trial has not ended. Raises RunError."""
    path = folder / OUTCOME_FILE
    try:
        return read_model(
            path, TrialRecord, TRIAL_SCHEMA, MAX_OUTCOME_BYTES, "delete the folder and run the trial again"
        )
    except FileNotFoundError:
        return None


def missing_measurements(requested: CompareSettings | RunSettings, record: TrialRecord) -> Iterator[str]:
    """A line for each requested measurement that is missing in the record of a complete trial of a live tracker."""
    if record.role == "recorded":
        return
    missing = {
        "--latency": requested.latency and record.latency_ms is None,
        "--deadline": requested.deadline and record.deadline is None,
        "--degrade": requested.degrade is not None
        and (record.robustness is None or record.robustness.degradation != requested.degrade),
    }
    for option in (option for option, is_missing in missing.items() if is_missing):
        yield (
            f"{record.label}@{record.recording}: {option} was requested and failed (reason: `notices` in summary.json):"
            " compare again with --resume"
        )
