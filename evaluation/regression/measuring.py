"""Measuring a run: its folder checked for completeness and reduced to counts by unit, stratum and step band."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from gridtrack.common.errors import GridtrackError
from gridtrack.evaluation.comparison.measurements import missing_measurements
from gridtrack.evaluation.regression.measurement import (
    BLOCK_S,
    Measurement,
    Speed,
    SplitKey,
    TrialCounts,
    Unmeasured,
)
from gridtrack.evaluation.regression.units import read_units
from gridtrack.evaluation.results.files import RunError
from gridtrack.evaluation.results.recording import RecordingIdentity
from gridtrack.evaluation.results.run_record import RUN_FILE, RunRecord, RunSettings, read_run_record
from gridtrack.evaluation.results.trial_record import TrialRecord, read_trial_record
from gridtrack.evaluation.statistics.jackknife import LEAST_UNITS


def measure_run(run: Path, like: Measurement | None = None) -> Measurement:
    """The counts of a complete run, in the statistical units of `like`, else in units chosen for it.

    Raises Unmeasured where the run is not complete: a trial failed, is partial or missing, nothing was scored, or a
    requested measurement is missing; RunError where `run` is not a run's folder.
    """
    record = _read_run_record(run)
    configuration = record.configuration
    if record.status != "complete":
        raise Unmeasured([f"{run}: the run is '{record.status}', not complete: continue it with --resume"])
    if not configuration.trials:
        raise Unmeasured([f"{run}: the run has no trials: nothing was measured"])
    splits = {name: _split_key(run, name, split) for name, split in configuration.recordings.items()}
    block_s = like.block_s if like else _block_s(configuration.recordings)
    trackers: dict[str, dict[str, Any]] = {}
    reasons: list[str] = []
    for name, trial in configuration.trials.items():
        label, _, recording = name.partition("@")
        entry = trackers.setdefault(label, {"tracker": trial.tracker, "options": trial.options, "recordings": {}})
        try:
            counts = _trial_counts(run, name, splits.get(recording), block_s, record.settings)
            entry["recordings"][recording] = counts
        except Unmeasured as error:
            reasons += error.reasons
        except GridtrackError as error:
            reasons.append(str(error))
        except ValidationError as error:
            reasons.append(f"{name}: its scores cannot be kept ({error.errors()[0]['msg']})")
    if reasons:
        raise Unmeasured(reasons)
    return _measurement(run, record, splits, trackers, block_s)


def _block_s(recordings: Mapping[str, RecordingIdentity]) -> float | None:
    """The length of a block; None, whole recordings, where these are enough units."""
    longest = max((split.cycle_s for split in recordings.values() if split.cycle_s), default=0.0)
    return None if len(recordings) >= LEAST_UNITS else max(BLOCK_S, longest)


def _measurement(
    run: Path, record: RunRecord, splits: Mapping[str, SplitKey], trackers: Mapping[str, Any], block_s: float | None
) -> Measurement:
    content = {
        "command": record.command,
        "versions": record.versions,
        "block_s": block_s,
        "recordings": splits,
        "trackers": trackers,
    }
    try:
        return Measurement.model_validate(content)
    except ValidationError as error:
        raise Unmeasured([f"{run}: not a run that can be measured ({error.errors()[0]['msg']})"]) from None


def _trial_counts(
    run: Path, name: str, split: SplitKey | None, block_s: float | None, requested: RunSettings
) -> TrialCounts:
    folder = run / name
    if split is None or folder.parent != run:
        raise RunError(f"{run / RUN_FILE}: '{name}' is no trial of this run")
    record = read_trial_record(folder)
    _require_complete(name, record)
    assert record is not None
    record.require_own_files(folder)
    if missing := list(missing_measurements(requested, record)):
        raise Unmeasured(missing)
    strata = tuple(record.thresholds.values)
    if not strata:
        raise Unmeasured([f"{name}: its record has no thresholds, so no stratum was scored: run it again"])
    units = read_units(folder, split.horizons_s, strata, block_s, record.frames_scored)
    latency = record.latency_ms
    timed = latency is not None and min(latency.update.p50, latency.predict.p50) > 0.0
    speed = Speed(update_ms=latency.update.p50, predict_ms=latency.predict.p50) if latency and timed else None
    measured = {"deadline": record.deadline, "degrade": record.robustness}
    measurements = tuple(name for name, found in measured.items() if found is not None)
    return TrialCounts.model_validate(
        {"weights_sha256": record.weights_sha256, "units": units, "speed": speed, "figures": measurements}
    )


def _require_complete(name: str, record: TrialRecord | None) -> None:
    """Check that a trial scored every forecast. Raises Unmeasured."""
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


def _split_key(run: Path, name: str, identity: RecordingIdentity) -> SplitKey:
    try:
        return SplitKey.model_validate(identity.model_dump(include=set(SplitKey.model_fields)))
    except ValidationError as error:
        first = error.errors()[0]
        raise RunError(f"{run / RUN_FILE}: recording '{name}': {first['loc'][0]}: {first['msg']}") from None


def _read_run_record(run: Path) -> RunRecord:
    if not run.is_dir():
        raise RunError(f"{run}: there is no such run's folder; `gridtrack compare ... --out RUN` makes one")
    try:
        return read_run_record(run)
    except FileNotFoundError:
        raise Unmeasured([f"{run}: it has no {RUN_FILE}, so nothing was measured: compare with --out {run}"]) from None
