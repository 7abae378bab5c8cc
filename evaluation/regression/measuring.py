"""Measuring a run: its folder checked for completeness and reduced to sums by unit, stratum and step band."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from gridtrack.common.errors import GridtrackError
from gridtrack.common.files import refuse_links
from gridtrack.evaluation.hosting.limits import SCRATCH
from gridtrack.evaluation.regression.measurement import (
    BANDS,
    MeasuredTrial,
    Measurement,
    Speed,
    SplitKey,
    UnitSums,
    Unmeasured,
)
from gridtrack.evaluation.runs.finished import FinishedTrial, RunTrials
from gridtrack.evaluation.runs.result_files import RunError
from gridtrack.evaluation.runs.run_record import (
    RUN_FILE,
    RecordingIdentity,
    RunRecord,
    RunSettings,
    TrialIdentity,
    read_run_record,
)
from gridtrack.evaluation.runs.sums import ScoredFrames, TrialSums
from gridtrack.evaluation.runs.trial_record import TrialRecord, missing_measurements, read_trial_record
from gridtrack.evaluation.scores.definition import Ratio, ScoreDefinition, Sums
from gridtrack.evaluation.scores.f1 import F1
from gridtrack.evaluation.scores.registry import scores
from gridtrack.evaluation.statistics.units import UnitRule

SERVER = "gridtrack.trackers.serve"
"""The module that serves a tracker of a Python environment; the interpreter precedes it."""


@dataclass(frozen=True, slots=True)
class ReadTrial:
    """A trial's record, its sums, and the horizons of its steps, seconds."""

    record: TrialRecord
    sums: TrialSums
    horizons_s: tuple[float, ...]

    @property
    def frames(self) -> ScoredFrames:
        """The scored frames."""
        return self.sums.frames


ReadTrials = dict[str, dict[str, ReadTrial]]
"""The trials of a run by label and recording."""


def measure_run(run: Path, like: Measurement | None = None, foreign: Sequence[str] = ()) -> Measurement:
    """The sums of a complete run, in the statistical units of `like`, else in units chosen for it.

    `foreign`: names of scores of other packages. Only scores with a margin are measured.

    Raises Unmeasured if a trial failed, is partial or missing, nothing was scored, no cell was occupied, or a requested
    measurement is missing; RunError if `run` is not a run's folder.
    """
    record = _read_run_record(run)
    configuration = record.configuration
    if record.status != "complete":
        raise Unmeasured([f"{run}: the run is '{record.status}', not complete: continue it with --resume"])
    if not configuration.trials:
        raise Unmeasured([f"{run}: the run has no trials: nothing was measured"])
    splits = {name: _split_key(run, name, split) for name, split in configuration.recordings.items()}
    trials = _read_trials(run, record, splits)
    block_s = like.block_s if like else _block_s(configuration.recordings, trials)
    scored = [score for score in scores(foreign) if any(output.margin is not None for output in score.outputs)]
    judged = [name for name in splits if like is None or name in like.recordings]
    content = {
        "command": record.command,
        "versions": record.versions,
        "scoring_rules": configuration.scoring_rules,
        "block_s": block_s,
        "scores": {label: _parts(own, scored) for label, own in trials.items()},
        "recordings": splits,
        "trackers": {
            label: {
                **_identity(configuration.trials, label),
                "role": next(iter(own.values())).record.role,
                "recordings": _units(own, splits, judged, block_s, scored),
            }
            for label, own in trials.items()
        },
    }
    try:
        measured = Measurement.model_validate(content)
    except ValidationError as error:
        raise Unmeasured([f"{run}: not a run that can be measured ({error.errors()[0]['msg']})"]) from None
    if not any(_any_occupied(measured, label, trial) for label, _, trial in measured.trials()):
        raise Unmeasured([f"{run}: no cell was occupied in any stratum and step band: nothing was measured"])
    return measured


def _any_occupied(run: Measurement, label: str, trial: MeasuredTrial) -> bool:
    """Whether any cell was occupied in a scored step of a trial."""
    by_band = [sums for unit in trial.units for bands in unit.sums[F1.name].values() for sums in bands.values()]
    found = F1.value(Sums(np.array(by_band), run.scores[label][F1.name]))[F1.lead.name]
    assert isinstance(found, Ratio)
    return bool(np.any(found.support))


def _read_trials(run: Path, record: RunRecord, splits: Mapping[str, SplitKey]) -> ReadTrials:
    """Every trial of the run. Raises Unmeasured with the reasons of all trials that cannot be measured."""
    trials: ReadTrials = {}
    reasons: list[str] = []
    for name in record.configuration.trials:
        label, _, recording = name.partition("@")
        own = trials.setdefault(label, {})
        try:
            own[recording] = _read_trial(run, name, splits.get(recording), record.settings)
        except Unmeasured as error:
            reasons += error.reasons
        except GridtrackError as error:
            reasons.append(str(error))
    for own in trials.values():
        reasons += _repeated_frames(own, splits)
    if reasons:
        raise Unmeasured(list(dict.fromkeys(reasons)))
    return trials


def _read_trial(run: Path, name: str, split: SplitKey | None, requested: RunSettings) -> ReadTrial:
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
    sums = TrialSums(folder)
    if len(sums.frames.stamps_ns) != record.frames_scored or sums.steps != len(split.horizons_s) - 1:
        raise Unmeasured(
            [f"{name}: its scores do not match the {record.frames_scored} forecasts of its record: run it again"]
        )
    return ReadTrial(record, sums, split.horizons_s)


def _repeated_frames(trials: Mapping[str, ReadTrial], splits: Mapping[str, SplitKey]) -> Iterator[str]:
    """A reason for each pair of recordings that share scored frames."""
    for one, other in combinations(trials, 2):
        stamps = [trials[name].frames.stamps_ns for name in (one, other)]
        if splits[one].source_sha256 == splits[other].source_sha256 and (
            max(its[0] for its in stamps) <= min(its[-1] for its in stamps)
        ):
            yield f"{one} and {other} are of one source and overlap: compare with one of them, or shorter stretches"


def _block_s(recordings: Mapping[str, RecordingIdentity], trials: ReadTrials) -> float | None:
    """The length of a block, as for the intervals of a comparison; None if whole sources are the units."""
    finished = [
        FinishedTrial(trial.record, trial.sums.path.parent, label, {}, "")
        for label, own in trials.items()
        for trial in own.values()
    ]
    return RunTrials(recordings, finished).unit_rule(list(recordings)).block_s


def _parts(trials: Mapping[str, ReadTrial], scores: Sequence[ScoreDefinition]) -> dict[str, tuple[str, ...]]:
    """The parts of each score that a tracker has on every recording."""
    layouts = [trial.sums.layouts for trial in trials.values()]
    names = [score.name for score in scores if all(score.name in trial.sums.scores for trial in trials.values())]
    return {name: layouts[0][name].parts for name in names if len({one[name].parts for one in layouts}) == 1}


def _units(
    trials: Mapping[str, ReadTrial],
    splits: Mapping[str, SplitKey],
    judged: Sequence[str],
    block_s: float | None,
    scores: Sequence[ScoreDefinition],
) -> dict[str, dict[str, Any]]:
    """The units of one tracker by recording. The recordings to be `judged` are divided into units first, so that
    additional recordings of a run do not change these units."""
    content: dict[str, dict[str, Any]] = {}
    names_of_scores = list(_parts(trials, scores))
    for names in ([name for name in trials if name in judged], [name for name in trials if name not in judged]):
        rule = UnitRule(tuple(splits[name].source_sha256 for name in names), block_s)
        numbers = rule.units_of([trials[name].frames.stamps_ns for name in names])
        for name, own in zip(names, numbers, strict=True):
            units = tuple(_unit_sums(trials[name], own, names_of_scores))
            content[name] = {"units": units, **_beside_scores(trials[name].record)}
    return content


def _unit_sums(trial: ReadTrial, numbers: NDArray[np.int64], scores: Sequence[str]) -> Iterator[UnitSums]:
    """The units of a trial with frames in the units `numbers` (F,), in the order of time.

    Strata of cells are judged; slices of a score, of which there are many, are not.
    """
    units, steps = np.unique(numbers), _steps_by_band(trial.horizons_s)
    own, of_cells = np.searchsorted(units, numbers), trial.record.thresholds.values
    strata = {score: [name for name in trial.sums.layouts[score].strata if name in of_cells] for score in scores}
    read = {
        score: trial.sums.by_unit(score, own, range(trial.sums.steps + 1), strata[score]).values for score in scores
    }
    for u, unit in enumerate(units.tolist()):
        frames = trial.frames.at(own == u)
        yield UnitSums(
            unit=unit,
            frames=len(frames.stamps_ns),
            delivered=_digest(frames),
            sums={
                score: {
                    stratum: {band: _rounded(sums[u, its, k].sum(axis=0)) for band, its in steps.items()}
                    for k, stratum in enumerate(strata[score])
                }
                for score, sums in read.items()
            },
        )


def _steps_by_band(horizons_s: Sequence[float]) -> dict[str, list[int]]:
    """The steps of each band; step 0 is in none.

    A step up to half a period beyond a limit is below it, because the step nearest to half a second may be: at 7 Hz it
    is 0.571429 s ahead, in digits of `horizons_s`.
    """
    half_s = 0.501 * (horizons_s[1] - horizons_s[0])
    bands = [
        next((name for name, (low, high) in BANDS.items() if low < horizon_s - half_s <= high), None)
        for horizon_s in horizons_s
    ]
    return {name: [step for step, its in enumerate(bands) if its == name] for name in BANDS if name in bands}


def _rounded(sums: NDArray[np.float64]) -> tuple[float, ...]:
    """Whole numbers as they are, others to six digits: the order of additions changes further digits."""
    return tuple(int(one) if float(one).is_integer() else float(f"{one:.6g}") for one in sums.tolist())


def _digest(frames: ScoredFrames) -> str:
    """A digest of the stamps of the scored frames and of every frame delivered until then."""
    content = list(zip(frames.stamps_ns.tolist(), frames.delivered.tolist(), strict=True))
    return hashlib.blake2b(repr(content).encode(), digest_size=16).hexdigest()


def _beside_scores(record: TrialRecord) -> dict[str, Any]:
    latency, deadline, robustness = record.latency_ms, record.deadline, record.robustness
    timed = latency is not None and min(latency.update.p50, latency.predict.p50) > 0.0
    kinds = robustness.kinds if robustness else {}
    return {
        "weights_sha256": record.weights_sha256,
        "recoveries": record.recoveries,
        "speed": Speed(update_ms=latency.update.p50, predict_ms=latency.predict.p50) if latency and timed else None,
        "deadline_rates": tuple(at.rate for at in deadline.rates) if deadline else (),
        "degradations": {kind: tuple(at.value for at in points) for kind, points in kinds.items()},
    }


def _identity(trials: Mapping[str, TrialIdentity], label: str) -> dict[str, Any]:
    trial = next(trial for name, trial in trials.items() if name.partition("@")[0] == label)
    return {
        "tracker": trial.tracker,
        "options": trial.options,
        "points": trial.points,
        "program": _program(trial.argv),
        "seed": trial.seed,
    }


def _program(argv: Sequence[str]) -> tuple[str, ...]:
    """The command without the folder of its program, and without the interpreter of a tracker in Python."""
    if SERVER in argv:
        return tuple(argv[argv.index(SERVER) :])
    return (Path(argv[0]).name, *argv[1:]) if argv else ()


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
    if not record.complete:
        raise Unmeasured([f"{name}: partial, {record.frames_scored} of {record.frames_expected} forecasts were scored"])


def _split_key(run: Path, name: str, identity: RecordingIdentity) -> SplitKey:
    try:
        content = identity.model_dump(include=set(SplitKey.model_fields))
        return SplitKey.model_validate(content | {"source_sha256": identity.source_sha256 or identity.sha256})
    except ValidationError as error:
        first = error.errors()[0]
        raise RunError(f"{run / RUN_FILE}: recording '{name}': {first['loc'][0]}: {first['msg']}") from None


def _read_run_record(run: Path) -> RunRecord:
    if not run.is_dir():
        raise RunError(f"{run}: there is no such run's folder; `gridtrack compare ... --out RUN` makes one")
    refuse_links(run, RunError, unread=SCRATCH)
    try:
        return read_run_record(run)
    except FileNotFoundError:
        raise Unmeasured([f"{run}: it has no {RUN_FILE}, so nothing was measured: compare with --out {run}"]) from None
