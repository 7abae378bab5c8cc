"""The history of a regression check: a JSON file for each verdict, never changed and never removed."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import Field, ValidationError

from gridtrack.common.config import Settings
from gridtrack.common.errors import GridtrackError
from gridtrack.common.files import read_json, sha256_of, write_text
from gridtrack.evaluation.regression.baseline import digest_of
from gridtrack.evaluation.regression.judging import VerdictRow, judged_since
from gridtrack.evaluation.regression.measurement import Baseline
from gridtrack.evaluation.regression.speed import SpeedRow, TurnsRow
from gridtrack.evaluation.regression.verdict import Verdict

HISTORY_SCHEMA: Final = 1
MAX_ENTRY_BYTES = 4 << 20
STAMP = "%Y%m%dT%H%M%S%fZ"
Text = Annotated[str, Field(max_length=2000)]


class HistoryError(GridtrackError):
    """A folder of a history is incomplete, or a file in it is invalid."""


class HistoryScore(Settings):
    """One score of a run, over all units; `value` is None if no cell was occupied."""

    label: Text
    score: Text
    lower_is_better: bool = False
    stratum: Text
    band: Text
    value: float | None
    standing: Text


class HistorySpeed(Settings):
    """The time of a call as a multiple of the time of `against`, and its 95 % interval if known."""

    label: Text
    call: Literal["update", "predict"]
    against: Text
    ratio: float
    low: float | None = None
    high: float | None = None
    standing: Text


class HistoryEntry(Settings):
    """One verdict: when, on which commit, against which baseline, with which scores and times."""

    schema_version: Literal[1] = Field(default=HISTORY_SCHEMA, alias="schema")
    recorded: Text
    """UTC, as in the name of the file."""
    previous: Text
    """The digest of the newest entry when this one was written; empty for the first."""
    commit: Text
    """Of the working directory; empty outside a git repository."""
    changed: bool
    """Whether a tracked file differed from the commit."""
    baseline: Text
    """SHA-256 of the baseline's file; empty if there is none."""
    frames: Text = ""
    """Digest of the recordings and the scoring rules: only entries with equal digests are compared. Empty in entries of
    earlier versions, and if nothing was measured."""
    update: bool = False
    """Whether the run became the baseline."""
    verdict: Literal["no worse", "worse", "not measured"]
    reasons: tuple[Text, ...] = ()
    """Why nothing was measured."""
    floors: tuple[Text, ...] = ()
    """Labels of the rows that every tracker must beat."""
    scores: tuple[HistoryScore, ...] = ()
    speed: tuple[HistorySpeed, ...] = ()

    @property
    def digest(self) -> str:
        """SHA-256 of its content, which the next entry names."""
        return digest_of(self.model_dump(mode="json", by_alias=True))


History = list[tuple[str, HistoryEntry]]
"""Entries with their digests, the oldest first."""


def read_history(folder: Path) -> History:
    """The entries in `folder`, checked; none if there is no such folder. Raises HistoryError."""
    history = [_read(path) for path in sorted(folder.glob("*.json"))]
    known = {digest for digest, _ in history}
    for _, entry in history:
        if entry.previous and entry.previous not in known:
            raise HistoryError(
                f"{folder}: the entry before {entry.recorded} is missing: restore it, or begin another folder"
            )
    return history


def require_newest(folder: Path, history: History, baseline: Baseline) -> None:
    """Raise HistoryError if the entry that was the newest when `baseline` was made is missing."""
    if baseline.history and baseline.history not in {digest for digest, _ in history}:
        raise HistoryError(
            f"{folder}: the entry that was the newest when the baseline was made is missing: restore it, or begin"
            " another folder with --update --history"
        )


def digest_of_frames(baseline: Baseline) -> str:
    """A digest of the recordings and the scoring rules."""
    first = baseline.first
    splits = {name: split.model_dump(mode="json") for name, split in first.recordings.items()}
    return digest_of([first.scoring_rules, splits])


def since_first(history: History, frames: str, row: VerdictRow) -> VerdictRow | None:
    """The row compared with the first entry of these frames that has it; None without such an entry."""
    found = _values_of(history, frames, row)
    return judged_since(row, found[0][0], f"the first entry of the history ({found[0][1]})") if found else None


def since_best(history: History, frames: str, row: VerdictRow) -> VerdictRow | None:
    """The row compared with the entry of these frames with the best value; None without such an entry."""
    found = _values_of(history, frames, row)
    if not found:
        return None
    best = (max if row.higher_is_better else min)(found, key=lambda one: one[0])
    return judged_since(row, best[0], f"the best entry of the history ({best[1]})")


def _values_of(history: History, frames: str, row: VerdictRow) -> list[tuple[float, str]]:
    """The values of a row in the entries of these frames, each with the name of its entry, the oldest first; empty if
    the run has no value."""
    key = (row.label, row.name, row.stratum, row.band)
    return [
        (score.value, _name_of(entry))
        for _, entry in (history if row.run is not None else ())
        if entry.frames == frames
        for score in entry.scores
        if (score.label, score.score, score.stratum, score.band) == key and score.value is not None
    ]


def _name_of(entry: HistoryEntry) -> str:
    """The day, and the commit where there is one."""
    return f"{entry.recorded[:8]}, commit {entry.commit[:7]}" if entry.commit else entry.recorded[:8]


def judged_by_history(verdict: Verdict, history: History, frames: str) -> Verdict:
    """`verdict`, in which scores that fell since the best entry of these frames are worse too."""
    if not any(entry.frames == frames for _, entry in history):
        note = "no entry of the history is of these frames: the baseline alone judges"
        return replace(verdict, notes=(*verdict.notes, note)) if history else verdict
    found = (since_best(history, frames, row) for row in verdict.rows if verdict.standing_of(row) != "worse")
    return replace(verdict, below_best=tuple(row for row in found if row is not None and row.verdict == "worse"))


def new_entry(
    history: History, baseline: Path, result: Verdict | Sequence[str], frames: str = "", *, update: bool = False
) -> HistoryEntry:
    """The next entry of `history`, with `result`: a verdict, or the reasons why nothing was measured.

    `baseline`: its file. `frames`: its `digest_of_frames`. `update`: the run becomes the baseline, and replaces the
    file `baseline`.
    """
    commit, changed = _commit(Path.cwd())
    return HistoryEntry(
        recorded=datetime.now(UTC).strftime(STAMP),
        previous=history[-1][0] if history else "",
        commit=commit,
        changed=changed,
        baseline=sha256_of(baseline) if baseline.is_file() else "",
        frames=frames,
        update=update,
        **_content(result),
    )


def write_entry(folder: Path, entry: HistoryEntry) -> Path:
    """Write an entry into the folder of its history, and return its file. Raises HistoryError."""
    path = folder / f"{entry.recorded}-{entry.digest[:12]}.json"
    content = {**entry.model_dump(mode="json", by_alias=True), "digest": entry.digest}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_text(path, json.dumps(content, indent=1, allow_nan=False) + "\n")
    except OSError as error:
        raise HistoryError(f"{path}: the entry cannot be written ({error.strerror})") from None
    return path


def _content(result: Verdict | Sequence[str]) -> dict[str, Any]:
    """The fields of an entry that contain the result."""
    if not isinstance(result, Verdict):
        return {"verdict": "not measured", "reasons": tuple(reason[:2000] for reason in result)}
    return {
        "verdict": "worse" if result.worse else "no worse",
        "floors": result.floors,
        "scores": tuple(_score(row, result) for row in result.rows),
        "speed": tuple(_time(row, result) for row in chain[SpeedRow | TurnsRow](result.speed, result.turns)),
    }


def _time(row: SpeedRow | TurnsRow, verdict: Verdict) -> HistorySpeed:
    own = (
        {"against": row.reference, "ratio": row.ratio_run}
        if isinstance(row, SpeedRow)
        else {"against": row.base, "ratio": row.ratio, "low": row.low, "high": row.high}
    )
    return HistorySpeed.model_validate(
        {"label": row.label, "call": row.call, **own, "standing": verdict.standing_of(row)}
    )


def _score(row: VerdictRow, verdict: Verdict) -> HistoryScore:
    return HistoryScore(
        label=row.label,
        score=row.name,
        lower_is_better=not row.higher_is_better,
        stratum=row.stratum,
        band=row.band,
        value=row.run,
        standing=verdict.standing_of(row),
    )


def _read(path: Path) -> tuple[str, HistoryEntry]:
    content = read_json(path, MAX_ENTRY_BYTES, HistoryError)
    if content.get("schema") != HISTORY_SCHEMA:
        found = str(content.get("schema"))[:20]
        raise HistoryError(
            f"{path}: schema {found!r} of a history; this gridtrack reads schema {HISTORY_SCHEMA}: read it with the"
            " version that wrote it, or begin another folder"
        )
    digest = content.pop("digest", None)
    if digest != digest_of(content):
        raise HistoryError(f"{path}: changed since it was written (its digest is another): restore it")
    try:
        return digest, HistoryEntry.model_validate(content)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]["msg"]
        raise HistoryError(f"{path}: not an entry of a history ({first}): restore it") from None


def _commit(folder: Path) -> tuple[str, bool]:
    """The commit of `folder`, and whether tracked files differ from it; ("", False) outside a git repository."""
    head = _git(folder, "rev-parse", "HEAD")
    return head, bool(head and _git(folder, "status", "--porcelain", "--untracked-files=no"))


def _git(folder: Path, *arguments: str) -> str:
    try:
        done = subprocess.run(["git", "-C", str(folder), *arguments], capture_output=True, text=True, check=False)
    except FileNotFoundError:
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""
