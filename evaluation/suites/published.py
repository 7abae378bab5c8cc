"""A published row: the sums of one tracker on a suite in a small file, for comparisons that do not run it again."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import Field, ValidationError

from gridtrack.common.config import Settings
from gridtrack.common.files import read_json, write_text
from gridtrack.common.notices import Line
from gridtrack.evaluation.regression.baseline import digest_of, first_fault, lines_of
from gridtrack.evaluation.regression.measurement import Measurement, UnitSums
from gridtrack.evaluation.regression.measuring import measure_run
from gridtrack.evaluation.runs.run_record import Machine, read_run_record
from gridtrack.evaluation.runs.trial_record import read_trial_record
from gridtrack.evaluation.scores.registry import scores
from gridtrack.evaluation.suites.suite import ROWS, SuiteError

ROW_SCHEMA: Final = 1
MAX_ROW_BYTES = 16 << 20
ROW_SUFFIX = ".json"
KEPT_STRATA = ("in-motion", "visible")


class PublishedRow(Settings):
    """One tracker on a suite. `measurement` has the sums of this row alone; its label is the row's."""

    schema_version: Literal[1] = Field(default=ROW_SCHEMA, alias="schema")
    suite: str
    label: str
    credit: Line = ""
    """Who made the tracker, and where it is."""
    made: str = ""
    """UTC, ISO 8601."""
    machine: Machine | None = None
    seconds: Annotated[float, Field(ge=0.0)] = 0.0
    """Wall time of all trials together."""
    digest: str
    """SHA-256 of `measurement`; it shows a change by hand."""
    measurement: Measurement

    @property
    def selection(self) -> str:
        """The row as `[LABEL=]NAME[:key=value,...]`."""
        entry = self.measurement.trackers[self.label]
        points = {} if entry.points == "centres" else {"points": entry.points}
        options = ",".join(f"{key}={json.dumps(value)}" for key, value in (entry.options | points).items())
        return f"{self.label}={entry.tracker}{f':{options}' if options else ''}"


def rows_of_run(run: Path, suite: str, credit: str = "", like: Measurement | None = None) -> list[PublishedRow]:
    """The rows of a complete run on a suite, in the units of `like`. Raises Unmeasured, RunError."""
    measured, record = measure_run(run, like), read_run_record(run)
    found = []
    for label in measured.trackers:
        own = _alone(measured, label, suite)
        trials = [read_trial_record(run / f"{label}@{name}") for name in own.recordings]
        found.append(
            PublishedRow(
                suite=suite,
                label=label,
                credit=credit,
                made=record.started,
                machine=record.machine,
                seconds=round(sum(trial.times.wall_s for trial in trials if trial), 1),
                digest=digest_of(own.model_dump(mode="json", by_alias=True)),
                measurement=own,
            )
        )
    return found


def _alone(measured: Measurement, label: str, suite: str) -> Measurement:
    """The sums of one row: of the scores that may lead, in their own strata and in KEPT_STRATA.

    Folders of the machine, in its command and in options that name files, are left out.
    """
    leading = {score.name: {score.stratum, *KEPT_STRATA} for score in scores(()) if score.may_lead}
    entry = measured.trackers[label]

    def kept(unit: UnitSums) -> UnitSums:
        sums = {
            score: {stratum: bands for stratum, bands in strata.items() if stratum in leading[score]}
            for score, strata in unit.sums.items()
            if score in leading
        }
        return unit.model_copy(update={"sums": sums})

    recordings = {
        name: trial.model_copy(update={"units": tuple(map(kept, trial.units))})
        for name, trial in entry.recordings.items()
    }
    parts = {score: own for score, own in measured.scores[label].items() if score in leading}
    options = {key: _without_folder(value) for key, value in entry.options.items()}
    row = entry.model_copy(update={"recordings": recordings, "options": options})
    command = ("gridtrack", "suite", "run", suite, "--tracker", f"{label}={entry.tracker}")
    return measured.model_copy(update={"command": command, "trackers": {label: row}, "scores": {label: parts}})


def _without_folder(value: Any) -> Any:
    """The name of a file at an absolute path; other values as they are."""
    return Path(value).name if isinstance(value, str) and Path(value).is_absolute() else value


def write_row(path: Path, row: PublishedRow) -> None:
    """Write a row, with one line for each unit and stratum. Raises OSError."""
    write_text(path, lines_of(row.model_dump(mode="json", by_alias=True)))


def read_row(path: Path) -> PublishedRow:
    """The row in a file. Raises SuiteError if it is none, or was changed by hand."""
    try:
        content = read_json(path, MAX_ROW_BYTES, SuiteError)
        row = PublishedRow.model_validate(content)
    except FileNotFoundError:
        raise SuiteError(f"{path}: there is no such row; `gridtrack suite row RUN` writes one") from None
    except ValidationError as error:
        raise SuiteError(f"{path}: not a published row ({first_fault(error)})") from None
    if row.digest != digest_of(content["measurement"]) or set(row.measurement.trackers) != {row.label}:
        raise SuiteError(f"{path}: changed since it was written (its digest does not match): restore it")
    return row


def published_rows(folder: Path) -> list[PublishedRow]:
    """The rows of the suite in `folder`, by label. Raises SuiteError."""
    return [read_row(path) for path in sorted((folder / ROWS).glob(f"*{ROW_SUFFIX}"))]


def differing_recordings(one: PublishedRow, other: PublishedRow) -> list[str]:
    """The recordings on which two rows have other sums."""
    sides = [row.measurement.trackers[row.label].recordings for row in (one, other)]
    return [name for name, trial in sides[0].items() if trial.units != sides[1][name].units]


def row_file(row: PublishedRow) -> str:
    """The name of the file of a row."""
    return f"{row.label}{ROW_SUFFIX}"
