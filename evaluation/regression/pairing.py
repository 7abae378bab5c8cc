"""Pairing of a run with a baseline: same frames, cells and validation stretch, or an error with the difference."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from gridtrack.common.errors import ConfigurationError
from gridtrack.evaluation.regression.measurement import (
    Baseline,
    MeasuredTrial,
    Measurement,
    SplitKey,
    TrackerSums,
    UnitSums,
    Unmeasured,
)
from gridtrack.evaluation.statistics.jackknife import LEAST_UNITS

CELLS = "cells"
"""The part of a score that counts cells. It does not depend on the forecast, only on frames and rules."""
_SAME_ROW = ("tracker", "options", "points", "program")
"""Fields that identify the tracker of a label; weights and seed may differ."""


def require_paired(baseline: Baseline, run: Measurement) -> None:
    """Check that `run` has the trackers and frames of `baseline`. Raises Unmeasured with every reason."""
    reasons = [*_other_trackers(baseline.first, run), *_other_seeds(baseline, run)]
    if reasons:
        raise Unmeasured(reasons)
    _require_same_frames(baseline.first, run)


def require_comparable(runs: Sequence[Measurement]) -> None:
    """Check that `runs` can be one baseline: trainings or seeds of the same trackers, on the same frames.

    Raises Unmeasured if they do not pair, ConfigurationError for other options or too few units.
    """
    first, *others = runs
    for other in others:
        _require_same_frames(first, other)
        _require_same_frames(other, first)
        for label, entry in first.trackers.items():
            if difference := _difference(entry, other.trackers[label]):
                raise ConfigurationError(
                    f"'{label}' is not the same in two runs ({difference}): the runs of a baseline are trainings or"
                    " seeds of one tracker with one set of options"
                )
    trials = next(iter(first.trackers.values())).recordings.values()
    units = len({unit.unit for trial in trials for unit in trial.units})
    if others and units < LEAST_UNITS:
        raise ConfigurationError(
            f"{len(runs)} runs of {units} unit{'s' if units != 1 else ''}: the spread between trainings needs"
            f" {LEAST_UNITS} or more; give one run, and set the allowed fall with --tolerance"
        )


def _require_same_frames(baseline: Measurement, run: Measurement) -> None:
    """Check that `run` has every trial of `baseline`, on the same frames, scored by the same rules.

    Raises Unmeasured with every reason.
    """
    reasons = [*_other_rules(baseline, run), *_missing_entries(baseline, run), *_other_splits(baseline, run)]
    reasons += _other_parts(baseline, run)
    if not reasons:
        reasons = [*_other_units(baseline, run), *_other_measurements(baseline, run)]
    if reasons:
        raise Unmeasured(reasons)


def _other_rules(baseline: Measurement, run: Measurement) -> Iterator[str]:
    then, now = baseline.scoring_rules, run.scoring_rules
    if then != now:
        yield (
            f"the baseline was scored by other rules (number {then}, the run by number {now}): make it again with"
            " --update"
        )


def _other_parts(baseline: Measurement, run: Measurement) -> Iterator[str]:
    for label, scores in baseline.scores.items():
        for score, parts in scores.items():
            if run.scores.get(label, {}).get(score, parts) != parts:
                yield f"{label}: {score} has other sums than in the baseline: make the baseline again with --update"


def _as_then(baseline: Measurement) -> str:
    """How to fix the mismatch."""
    return f"compare as for the baseline ({shlex.join(baseline.command)}), or make the baseline again with --update"


def _missing_entries(baseline: Measurement, run: Measurement) -> Iterator[str]:
    for label in sorted(baseline.trackers.keys() - run.trackers.keys()):
        yield f"tracker {label} of the baseline is missing in the run: run it too, or make the baseline again"
    for name in sorted(baseline.recordings.keys() - run.recordings.keys()):
        yield f"recording {name} of the baseline is missing in the run: run it too, or make the baseline again"


def _other_splits(baseline: Measurement, run: Measurement) -> Iterator[str]:
    for name, then in baseline.recordings.items():
        now = run.recordings.get(name, then)
        if key := differing_key(then, now):
            old, new = (str(getattr(side, key))[:80] for side in (then, now))
            yield (
                f"{name}: not run as for the baseline ({key}: '{old}' in the baseline, '{new}' in the run):"
                f" {_as_then(baseline)}"
            )


def differing_key(one: SplitKey, other: SplitKey) -> str:
    """The name of the first field in which two recordings of runs differ; empty if they pair."""
    return next((key for key in SplitKey.model_fields if getattr(one, key) != getattr(other, key)), "")


def _other_units(baseline: Measurement, run: Measurement) -> Iterator[str]:
    usual: dict[str, int] = {}
    for label, name, then in baseline.trials():
        cells = {score: parts.index(CELLS) for score, parts in baseline.scores[label].items() if CELLS in parts}
        problem = _unit_mismatch(then, run.trackers[label].recordings[name], cells)
        if not problem and len(then.units) != usual.setdefault(name, len(then.units)):
            problem = "its number of units differs from the other trackers"
        if problem:
            yield f"{label}@{name}: {problem}, so the trials do not pair: make the baseline again with --update"


def _other_trackers(baseline: Measurement, run: Measurement) -> Iterator[str]:
    for label, then in baseline.trackers.items():
        difference = _difference(then, run.trackers[label]) if label in run.trackers else ""
        if difference:
            yield (
                f"{label} is not the tracker of the baseline ({difference}): give it another label, or make the"
                " baseline again with --update"
            )


def _difference(then: TrackerSums, now: TrackerSums) -> str:
    """The first difference between two trackers under one label; empty if they are equal."""
    for field in _SAME_ROW:
        old, new = getattr(then, field), getattr(now, field)
        if old != new:
            return f"{field}: {_text(old)} in the baseline, {_text(new)} in the run"
    return ""


def _text(value: Any) -> str:
    if isinstance(value, tuple):
        return f"'{' '.join(value)}'"[:80]
    if isinstance(value, dict):
        return " ".join(f"{key}={one}" for key, one in value.items())[:80] or "none"
    return f"'{value}'"[:80]


def _other_seeds(baseline: Baseline, run: Measurement) -> Iterator[str]:
    """Another seed is another sample of the tracker; only a baseline of several seeds shows its variance."""
    for label in baseline.first.trackers:
        seeds = {then.trackers[label].seed for then in baseline.runs}
        if label in run.trackers and len(seeds) == 1 and run.trackers[label].seed not in seeds:
            yield (
                f"{label}: seed {min(seeds)} in the baseline, {run.trackers[label].seed} in the run: compare with"
                f" --seed {min(seeds)}, or make the baseline of several seeds"
            )


def _other_measurements(baseline: Measurement, run: Measurement) -> Iterator[str]:
    """Measurements other than scores are not judged, but each one of the baseline must be in the run."""
    for label, name, then in baseline.trials():
        now = run.trackers[label].recordings[name]
        for option, old, new in (
            ("--deadline", then.deadline_rates, now.deadline_rates),
            ("--degrade", then.degradations, now.degradations),
        ):
            if old and old != new:
                what = "with other values" if new else "for the baseline and not"
                yield f"{label}@{name}: measured with {option} {what} in the run: {_as_then(baseline)}"


def _unit_mismatch(then: MeasuredTrial, now: MeasuredTrial, cells: Mapping[str, int]) -> str:
    """The reason why the units of two trials do not pair; empty if they do. `cells`: the index of CELLS by score."""
    if len(then.units) != len(now.units):
        return f"{len(then.units)} units in the baseline, {len(now.units)} in the run"
    for one, other in zip(then.units, now.units, strict=True):
        if (one.frames, one.delivered) != (other.frames, other.delivered):
            return "other frames were delivered than for the baseline"
        if missing := one.sums.keys() - other.sums.keys():
            return f"{', '.join(sorted(missing))} was scored for the baseline, and is not in the run"
        if any(_places(one, score, cells) != _places(other, score, cells) for score in one.sums):
            return "other strata or cells were scored than for the baseline"
    return ""


def _places(unit: UnitSums, score: str, cells: Mapping[str, int]) -> dict[str, dict[str, float | None]]:
    """The step bands of each stratum of a score, with their cells if the score counts them."""
    place = cells.get(score)
    return {
        stratum: {band: None if place is None else sums[place] for band, sums in bands.items()}
        for stratum, bands in unit.sums[score].items()
    }
