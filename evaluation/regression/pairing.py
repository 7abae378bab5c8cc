"""Pairing a run with a baseline: the same frames, cells and thresholds' stretch, or it is said what differs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.errors import ConfigurationError
from gridtrack.evaluation.regression.measurement import (
    BANDS,
    Baseline,
    Measurement,
    SplitKey,
    TrialCounts,
    Unmeasured,
)
from gridtrack.evaluation.statistics.uncertainty import LEAST_UNITS

Counts = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PairedRow:
    """One tracker, stratum and step band: TP, FP, FN, TN of the K runs of the baseline (K, U, 4) and of the run (U, 4)
    in units U, the log loss of each (K, U) and (U,), and the recording that each unit is of."""

    label: str
    stratum: str
    band: str
    trainings: Counts
    run: Counts
    log_losses: Counts
    run_log_loss: Counts
    recordings: tuple[str, ...]

    @property
    def baseline(self) -> Counts:
        """Mean counts (U, 4) of the baseline's runs."""
        mean: Counts = self.trainings.mean(axis=0)
        return mean

    @property
    def equal(self) -> bool:
        """Whether every count is as in some run of the baseline."""
        return bool((self.trainings == self.run).all(axis=(1, 2)).any())


def pair(baseline: Baseline, run: Measurement) -> tuple[PairedRow, ...]:
    """Rows of everything that the baseline holds. Raises Unmeasured, with every reason why something does not pair."""
    _require_paired(baseline.first, run)
    return tuple(row for label in baseline.first.trackers for row in _rows(label, baseline, run))


def require_comparable(runs: Sequence[Measurement]) -> None:
    """Whether `runs` are a baseline together: each a training or a seed of the same trackers, on the same frames.

    Raises Unmeasured where they do not pair, ConfigurationError where what lies between them could not be judged.
    """
    first, *others = runs
    for other in others:
        _require_paired(first, other)
        _require_paired(other, first)
        for label, entry in first.trackers.items():
            same = other.trackers[label]
            if (entry.tracker, entry.options) != (same.tracker, same.options):
                raise ConfigurationError(
                    f"'{label}' has other options in one run than in another: the runs of a baseline are trainings or"
                    " seeds of one tracker with one set of options"
                )
    units = sum(len(trial.units) for trial in next(iter(first.trackers.values())).recordings.values())
    if others and units < LEAST_UNITS:
        raise ConfigurationError(
            f"{len(runs)} runs of {units} unit{'s' if units != 1 else ''}: what separates trainings is judged on"
            f" {LEAST_UNITS} or more; give one run, and state with --tolerance what a tracker may lose"
        )


def _require_paired(baseline: Measurement, run: Measurement) -> None:
    """Raises Unmeasured, with every reason why `run` does not hold what `baseline` holds."""
    reasons = [*_missing(baseline, run), *_other_splits(baseline, run)]
    if not reasons:
        reasons = [*_other_units(baseline, run), *_missing_figures(baseline, run)]
    if reasons:
        raise Unmeasured(reasons)


def _missing(baseline: Measurement, run: Measurement) -> Iterator[str]:
    for label in sorted(baseline.trackers.keys() - run.trackers.keys()):
        yield f"tracker {label} of the baseline is missing in the run: run it too, or make the baseline again"
    for name in sorted(baseline.recordings.keys() - run.recordings.keys()):
        yield f"recording {name} of the baseline is missing in the run: run it too, or make the baseline again"


def _other_splits(baseline: Measurement, run: Measurement) -> Iterator[str]:
    for name, then in baseline.recordings.items():
        now = run.recordings.get(name, then)
        differing = [key for key in SplitKey.model_fields if getattr(then, key) != getattr(now, key)]
        if differing:
            key = differing[0]
            yield (
                f"{name}: not run as for the baseline ({key}: then {str(getattr(then, key))[:80]}, now"
                f" {str(getattr(now, key))[:80]}): compare as its `command` says, or make it again with --update"
            )


def _other_units(baseline: Measurement, run: Measurement) -> Iterator[str]:
    usual: dict[str, int] = {}
    for label, name, then in baseline.trials():
        problem = _difference(then, run.trackers[label].recordings[name])
        if not problem and len(then.units) != usual.setdefault(name, len(then.units)):
            problem = "it has another number of units than the other trackers"
        if problem:
            yield f"{label}@{name}: {problem}, so nothing pairs: make the baseline again with --update"


def _missing_figures(baseline: Measurement, run: Measurement) -> Iterator[str]:
    """What was measured beside the scores is not judged here, but must not be lost unnoticed."""
    for label, name, then in baseline.trials():
        for figure in then.figures:
            if figure not in run.trackers[label].recordings[name].figures:
                yield (
                    f"{label}@{name}: measured with --{figure} for the baseline, and not in the run: compare as its"
                    " `command` says, or make it again with --update"
                )


def _difference(then: TrialCounts, now: TrialCounts) -> str:
    """Why the units of two trials do not pair; "" where they do."""
    if len(then.units) != len(now.units):
        return f"{len(then.units)} units in the baseline, {len(now.units)} in the run"
    for one, other in zip(then.units, now.units, strict=True):
        if (one.frames, one.delivered) != (other.frames, other.delivered):
            return "other frames were delivered than for the baseline"
        if _cells(one.counts) != _cells(other.counts):
            return "other strata or cells were scored than for the baseline"
    return ""


def _cells(counts: dict[str, dict[str, tuple[int, int, int, int, float]]]) -> dict[tuple[str, str], tuple[int, int]]:
    """Occupied and free cells by stratum and band: given by the frames alone, whatever was forecast."""
    return {
        (stratum, band): (tp + fn, fp + tn)
        for stratum, bands in counts.items()
        for band, (tp, fp, fn, tn, _) in bands.items()
    }


def _rows(label: str, baseline: Baseline, run: Measurement) -> Iterator[PairedRow]:
    """The rows of one tracker over the units of every recording; a recording without a stratum counts nothing in it."""
    *then, now = (side.trackers[label].recordings for side in (*baseline.runs, run))
    units = [(name, unit) for name, trial in then[0].items() for unit in range(len(trial.units))]
    names = tuple(name for name, _ in units)
    strata = dict.fromkeys(s for name, unit in units for s in now[name].units[unit].counts)
    bands = {band for name, unit in units for found in now[name].units[unit].counts.values() for band in found}
    nothing = (0, 0, 0, 0, 0.0)
    for stratum in strata:
        for band in (name for name in BANDS if name in bands):
            sides = [
                [side[name].units[unit].counts.get(stratum, {}).get(band, nothing) for name, unit in units]
                for side in (*then, now)
            ]
            *old, new = np.array(sides, float)
            trainings = np.stack(old)
            yield PairedRow(label, stratum, band, trainings[..., :4], new[:, :4], trainings[..., 4], new[:, 4], names)
