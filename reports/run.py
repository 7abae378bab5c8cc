"""Reading a run's folder: run.json and summary.json, checked, as the report wants them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, ValidationError, model_validator

from gridtrack.common.errors import GridtrackError
from gridtrack.evaluation.scoring.splits import ORACLE
from gridtrack.evaluation.statistics.inference import ALL_RECORDINGS
from gridtrack.evaluation.statistics.summary import SCHEMA, SUMMARY
from gridtrack.reports.trial import Curve, Number, Read, Trial

MAX_BYTES = 256 << 20
"""A larger run.json or summary.json is refused before it is read."""
LONGEST_S, SHORTEST_STEP_S = 3600.0, 1e-5
"""Horizons that a page has room for, and how far apart: far more than any comparison asks for."""
UNDEFINED = "–"
"""What stands on the page where a score is not defined."""
FLOOR = ("persistence", "static-map", "blank")
"""Trackers that do not track: whoever does not beat them has not tracked."""


class ReportError(GridtrackError):
    """A run's folder that cannot be reported."""


class TrackerEntry(Read):
    """One row of the comparison: a tracker with its options, on every recording."""

    tracker: str
    points: str = ""
    """Which returns it was given: `raw` stands apart from the stream that all others saw."""
    options: dict[str, Any] = Field(default_factory=dict)
    recordings: dict[str, Trial]

    @property
    def ceiling(self) -> bool:
        """Whether it is what an ideal tracker could score: shown, and never ranked."""
        return self.tracker == ORACLE

    @property
    def floor(self) -> bool:
        """Whether it is one of the rows that every tracker must beat."""
        return self.tracker in FLOOR


class Recording(Read):
    """What was compared on one recording."""

    horizons_s: tuple[Annotated[float, Field(ge=0.0, le=LONGEST_S)], ...] = Field(min_length=2)
    stretch: str = ""
    """The tested one; `validation` is what thresholds were chosen on, empty where there was none."""
    validation: str = ""
    site: str = ""
    grid: str = ""
    frames: int = 0
    warm_up_frames: int = 0
    forecast_every_frames: int = 0
    pooled: bool = False
    """Whether it stands for all recordings of the run together."""
    parity: bool = True
    """Whether every tracker was delivered the same frames: only then are they ranked."""

    @property
    def period_s(self) -> float:
        """Of the stream: one step."""
        return self.horizons_s[1] - self.horizons_s[0]


class HeadlineTest(Read):
    """A tracker's F1 less the reference's at one horizon, and whether that is a difference."""

    stratum: str
    horizon_s: float
    f1: Number = None
    f1_low: Number = None
    f1_high: Number = None
    f1_p: Number = None
    p_holm: Number = None
    verdict: str


class Difference(Read):
    """One tracker against the reference on a recording, or on all."""

    recordings: str
    tracker: str
    reference: str
    units: int = 0
    frames: int = 0
    interval: str = ""
    headline: tuple[HeadlineTest, ...] = Field(default=(), max_length=100)


class ClassLosses(Read):
    """Log loss of a scan's classes less the reference's, per step."""

    nll_per_scan: Curve
    nll_per_scan_low: Curve
    nll_per_scan_high: Curve


class ClassDifference(Read):
    """What one tracker took cells for against the reference of classes, by kind, on a recording or on all."""

    recordings: str
    tracker: str
    reference: str
    kinds: dict[str, ClassLosses]


class Summary(Read):
    """summary.json; where recordings are pooled, all of them together stand first among `recordings`."""

    schema_version: int = Field(alias="schema")
    recordings: dict[str, Recording] = Field(min_length=1)
    trackers: dict[str, TrackerEntry]
    differences: tuple[Difference, ...] = ()
    class_differences: tuple[ClassDifference, ...] = ()
    notices: tuple[str, ...] = ()
    interrupted: bool = False

    @model_validator(mode="before")
    @classmethod
    def _pooled_stand_first(cls, content: Any) -> Any:
        """What is pooled is read as one more recording: whatever is shown of one is shown of all together."""
        return with_pooled(content) if _has_pooled(content) else content

    @model_validator(mode="after")
    def _curves_reach_every_horizon(self) -> Summary:
        for name, recording in self.recordings.items():
            if any(later - earlier < SHORTEST_STEP_S for earlier, later in pairwise(recording.horizons_s)):
                raise ValueError(f"{name}: horizons_s do not increase")
        for label, entry in self.trackers.items():
            for name, trial in entry.recordings.items():
                if name not in self.recordings:
                    raise ValueError(f"tracker {label} has scores on {name}, which is not among the recordings")
                steps = len(self.recordings[name].horizons_s)
                for stratum, curve in trial.curves:
                    if len(curve) != steps:
                        raise ValueError(f"{label} on {name}, {stratum}: {len(curve)} steps, expected {steps}")
        for one in self.class_differences:
            steps = len(self.recordings[one.recordings].horizons_s) if one.recordings in self.recordings else 0
            if any(len(curve) != steps for losses in one.kinds.values() for _, curve in losses):
                raise ValueError(f"{one.tracker} on {one.recordings}: class differences not of {steps} steps")
        return self


def _has_pooled(content: Any) -> bool:
    """Whether every row has scores over several recordings."""
    if not isinstance(content, dict) or not isinstance(content.get("recordings"), dict):
        return False
    entries = content["trackers"].values() if isinstance(content.get("trackers"), dict) else ()
    rows = [entry for entry in entries if isinstance(entry, dict)]
    whole = bool(rows) and all(row.get("pooled") and isinstance(row.get("recordings"), dict) for row in rows)
    return whole and len(content["recordings"]) > 1 and ALL_RECORDINGS not in content["recordings"]


def with_pooled(content: dict[str, Any]) -> dict[str, Any]:
    """summary.json with all recordings together as the first of them."""
    described = [one for one in content["recordings"].values() if isinstance(one, dict)]
    together = {
        **(described[0] if described else {}),
        "pooled": True,
        "stretch": f"{len(described)} recordings",
        "frames": sum(frames for one in described if isinstance(frames := one.get("frames", 0), int)),
        "parity": all(one.get("parity", True) for one in described),
    }
    trackers = {
        label: {**entry, "recordings": {ALL_RECORDINGS: entry["pooled"], **entry["recordings"]}}
        for label, entry in content["trackers"].items()
    }
    recordings = {ALL_RECORDINGS: together, **content["recordings"]}
    return {**content, "recordings": recordings, "trackers": trackers}


@dataclass(frozen=True)
class Run:
    """A run's folder, read: `name` tells it from the others on the page, `provenance` is run.json."""

    path: Path
    name: str
    summary: Summary
    provenance: dict[str, Any]

    def identity_of(self, recording: str) -> Any:
        """What decided the scores on one recording, its hash among them: equal for runs of the same frames."""
        configuration = self.provenance.get("configuration")
        recordings = configuration.get("recordings") if isinstance(configuration, dict) else None
        if self.summary.recordings[recording].pooled:
            return recordings
        return recordings.get(recording) if isinstance(recordings, dict) else None

    def trial_folder(self, label: str, recording: str) -> Path:
        """Where a trial's files lie. Raises ReportError for names that would lead out of the run's folder."""
        folder = self.path / f"{label}@{recording}"
        if folder.parent != self.path:
            raise ReportError(f"{self.path / SUMMARY}: '{label}@{recording}' is not the name of a folder in it")
        return folder


def read_runs(paths: Sequence[Path]) -> tuple[Run, ...]:
    """Read several runs' folders; each is named by its folder, or by its whole path where names collide.

    Raises ReportError.
    """
    folders = [path.resolve().name for path in paths]
    names = [str(path) if folders.count(name) > 1 else name for path, name in zip(paths, folders, strict=True)]
    return tuple(_read_run(path, name) for path, name in zip(paths, names, strict=True))


def _read_run(path: Path, name: str) -> Run:
    if not path.is_dir():
        raise ReportError(f"{path}: there is no such run's folder; `gridtrack compare ... --out RUN` makes one")
    raw = _read_json(path / SUMMARY, f"{path} has no {SUMMARY}: the run did not finish; continue it with --resume")
    schema = raw.get("schema")
    if schema != SCHEMA:
        raise ReportError(
            f"{path / 'summary.json'}: schema {schema!r}; this gridtrack reads schema {SCHEMA}:"
            " report it with the version that wrote it, or run the comparison again"
        )
    try:
        summary = Summary.model_validate(raw)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise ReportError(f"{path / 'summary.json'}: {where or 'content'}: {first['msg']}") from None
    return Run(path, name, summary, _read_json(path / "run.json", f"{path} has no run.json: it is not a run's folder"))


def _read_json(path: Path, if_missing: str) -> dict[str, Any]:
    """A file that holds one JSON object. Raises ReportError, with the line `if_missing` where there is no file."""
    try:
        if path.stat().st_size > MAX_BYTES:
            raise ReportError(f"{path}: {path.stat().st_size} bytes; more than {MAX_BYTES} are refused")
        content = json.loads(path.read_text("utf-8"))
    except FileNotFoundError:
        raise ReportError(if_missing) from None
    except OSError as error:
        raise ReportError(f"{path}: cannot be read ({error.strerror})") from None
    except (ValueError, RecursionError) as error:
        raise ReportError(f"{path}: not a JSON file ({error}); the run must be made again") from None
    if not isinstance(content, dict):
        raise ReportError(f"{path}: expected one JSON object, found {type(content).__name__}")
    return content
