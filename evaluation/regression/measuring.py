"""Measuring a run: its folder checked for completeness and reduced to counts by unit, stratum and step band."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from gridtrack.common.errors import GridtrackError
from gridtrack.evaluation.comparison.measurements import missing_measurements
from gridtrack.evaluation.comparison.run_folder import RUN, SCHEMA
from gridtrack.evaluation.regression.measurement import (
    BLOCK_S,
    Measurement,
    Speed,
    SplitKey,
    TrialCounts,
    Unmeasured,
)
from gridtrack.evaluation.regression.units import read_units
from gridtrack.evaluation.scoring.record import MAX_BYTES, RunError, TrialRecord, read_record
from gridtrack.evaluation.statistics.uncertainty import LEAST_UNITS
from gridtrack.recordings.degradation import Degradation

KEYS = frozenset(SplitKey.model_fields)


class _Part(BaseModel):
    """A part of run.json: what the gate does not need, it leaves alone."""

    model_config = ConfigDict(frozen=True, extra="ignore")


class _AskedTrial(_Part):
    tracker: str
    options: dict[str, Any]


class _RequestedMeasurements(_Part):
    latency: bool = False
    deadline: bool = False
    degrade: Degradation | None = None


class _Configuration(_Part):
    recordings: dict[str, dict[str, Any]]
    trials: dict[str, _AskedTrial]


class _RunFile(_Part):
    schema_version: Literal[1] = Field(alias="schema")
    status: str
    command: tuple[str, ...]
    versions: dict[str, str]
    settings: _RequestedMeasurements = _RequestedMeasurements()
    configuration: _Configuration


def measure_run(run: Path, like: Measurement | None = None) -> Measurement:
    """Everything that a run's folder counted, in the units of `like`, else in units chosen for it.

    Raises Unmeasured where the run is not complete: a trial failed, is partial or missing, nothing was scored, or a
    figure that was asked for beside the scores is missing; RunError where `run` is not a run's folder.
    """
    file = _read_run_file(run)
    if file.status != "complete":
        raise Unmeasured([f"{run}: the run is '{file.status}', not complete: continue it with --resume"])
    if not file.configuration.trials:
        raise Unmeasured([f"{run}: the run has no trials: nothing was measured"])
    splits = {name: _split_key(run, name, split) for name, split in file.configuration.recordings.items()}
    block_s = like.block_s if like else _block_s(file.configuration.recordings)
    trackers: dict[str, dict[str, Any]] = {}
    reasons: list[str] = []
    for name, asked in file.configuration.trials.items():
        label, _, recording = name.partition("@")
        entry = trackers.setdefault(label, {"tracker": asked.tracker, "options": asked.options, "recordings": {}})
        try:
            entry["recordings"][recording] = _trial_counts(run, name, splits.get(recording), block_s, file.settings)
        except Unmeasured as error:
            reasons += error.reasons
        except GridtrackError as error:
            reasons.append(str(error))
        except ValidationError as error:
            reasons.append(f"{name}: its scores cannot be kept ({error.errors()[0]['msg']})")
    if reasons:
        raise Unmeasured(reasons)
    return _measurement(run, file, splits, trackers, block_s)


def _block_s(splits: Mapping[str, Mapping[str, Any]]) -> float | None:
    """None, whole recordings, where these are enough units; else longer than the cycle of any place."""
    cycles = (split.get("cycle_s") for split in splits.values())
    longest = max((float(cycle) for cycle in cycles if isinstance(cycle, int | float)), default=0.0)
    return None if len(splits) >= LEAST_UNITS else max(BLOCK_S, longest)


def _measurement(
    run: Path, file: _RunFile, splits: Mapping[str, SplitKey], trackers: Mapping[str, Any], block_s: float | None
) -> Measurement:
    content = {
        "command": file.command,
        "versions": file.versions,
        "block_s": block_s,
        "recordings": splits,
        "trackers": trackers,
    }
    try:
        return Measurement.model_validate(content)
    except ValidationError as error:
        raise Unmeasured([f"{run}: not a run that can be measured ({error.errors()[0]['msg']})"]) from None


def _trial_counts(
    run: Path, name: str, split: SplitKey | None, block_s: float | None, asked: _RequestedMeasurements
) -> TrialCounts:
    folder = run / name
    if split is None or folder.parent != run:
        raise RunError(f"{run / RUN}: '{name}' is no trial of this run")
    record = read_record(folder)
    _refuse_incomplete(name, record)
    assert record is not None
    if missing := list(missing_measurements(asked, record)):
        raise Unmeasured(missing)
    strata = tuple(record.thresholds.values)
    units = read_units(folder, split.horizons_s, strata, block_s, record.frames_scored)
    latency = record.latency_ms
    timed = latency is not None and min(latency.update.p50, latency.predict.p50) > 0.0
    speed = Speed(update_ms=latency.update.p50, predict_ms=latency.predict.p50) if latency and timed else None
    measured = {"deadline": record.deadline, "degrade": record.robustness}
    figures = tuple(name for name, found in measured.items() if found is not None)
    return TrialCounts.model_validate(
        {"weights_sha256": record.weights_sha256, "units": units, "speed": speed, "figures": figures}
    )


def _refuse_incomplete(name: str, record: TrialRecord | None) -> None:
    """Raises Unmeasured for a trial that did not score every frame it was to score."""
    if record is None:
        raise Unmeasured([f"{name}: the trial is missing: continue the run with --resume"])
    if record.outcome != "ok":
        raise Unmeasured([f"{name}: {record.outcome}{f': {record.reason}' if record.reason else ''}"])
    if f"{record.label}@{record.recording}" != name:
        raise Unmeasured([f"{name}: holds the record of {record.label}@{record.recording}: run it again"])
    if not record.frames_scored:
        raise Unmeasured([f"{name}: nothing was scored"])
    if record.frames_scored != record.frames_expected:
        raise Unmeasured([f"{name}: partial, {record.frames_scored} of {record.frames_expected} forecasts were scored"])


def _split_key(run: Path, name: str, split: Mapping[str, Any]) -> SplitKey:
    try:
        return SplitKey.model_validate({key: value for key, value in split.items() if key in KEYS})
    except ValidationError as error:
        first = error.errors()[0]
        raise RunError(f"{run / RUN}: recording '{name}': {first['loc'][0]}: {first['msg']}") from None


def _read_run_file(run: Path) -> _RunFile:
    path = run / RUN
    if not run.is_dir():
        raise RunError(f"{run}: there is no such run's folder; `gridtrack compare ... --out RUN` makes one")
    try:
        if path.stat().st_size > MAX_BYTES:
            raise RunError(f"{path}: {path.stat().st_size} bytes; more than {MAX_BYTES} are refused")
        content = json.loads(path.read_text("utf-8"))
        if not isinstance(content, dict) or content.get("schema") != SCHEMA:
            raise RunError(f"{path}: not schema {SCHEMA} of a run: compare again with this version")
        return _RunFile.model_validate(content)
    except FileNotFoundError:
        raise Unmeasured([f"{run}: it has no {RUN}, so nothing was measured: compare with --out {run}"]) from None
    except ValidationError as error:
        first = error.errors()[0]
        raise RunError(f"{path}: {'.'.join(map(str, first['loc']))}: {first['msg']}: compare again") from None
    except (OSError, ValueError, RecursionError) as error:
        raise RunError(f"{path}: cannot be read as JSON ({str(error)[:80]})") from None
