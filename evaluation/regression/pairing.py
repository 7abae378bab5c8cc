"""Pairing of a run with a baseline: same frames, cells and validation stretch, or an error that says why not."""

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
from gridtrack.evaluation.statistics.jackknife import LEAST_UNITS

Counts = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PairedRow:
    """One tracker, stratum and step band: TP, FP, FN, TN of the K runs of the baseline (K, U, 4) and of the run (U, 4)
    in U units, their sums of the log loss (K, U) and (U,), and the recording of each unit."""

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
        """Counts (U, 4), the mean over the runs of the baseline."""
        mean: Counts = self.trainings.mean(axis=0)
        return mean

    @property
    def equal(self) -> bool:
        """Whether every count is equal to that of one run of the baseline."""
        return bool((self.trainings == self.run).all(axis=(1, 2)).any())


def pair(baseline: Baseline, run: Measurement) -> tuple[PairedRow, ...]:
    """The rows of every tracker of the baseline. Raises Unmeasured with every reason why the two do not pair."""
    _require_paired(baseline.first, run)
    return tuple(row for label in baseline.first.trackers for row in _paired_rows(label, baseline, run))


def require_comparable(runs: Sequence[Measurement]) -> None:
    """Check that `runs` can be one baseline: trainings or seeds of the same trackers, on the same frames.

    Raises Unmeasured where they do not pair, ConfigurationError for other options or too few units.
    """
    first, *others = runs
    for other in others:
        _require_paired(first, other)
        _require_paired(other, first)
        for label, entry in first.trackers.items():
            same = other.trackers[label]
            if (entry.tracker, entry.options) != (same.tracker, same.options):
                raise ConfigurationError(
                    f"'{label}' has different options in two runs: the runs of a baseline are trainings or"
                    " seeds of one tracker with one set of options"
                )
    units = sum(len(trial.units) for trial in next(iter(first.trackers.values())).recordings.values())
    if others and units < LEAST_UNITS:
        raise ConfigurationError(
            f"{len(runs)} runs of {units} unit{'s' if units != 1 else ''}: the spread between trainings needs"
            f" {LEAST_UNITS} or more; give one run, and the fall that is allowed with --tolerance"
        )


def _require_paired(baseline: Measurement, run: Measurement) -> None:
    """Check that `run` pairs with `baseline`. Raises Unmeasured with every reason why it does not."""
    reasons = [*_missing_entries(baseline, run), *_other_splits(baseline, run)]
    if not reasons:
        reasons = [*_other_units(baseline, run), *_missing_measurements(baseline, run)]
    if reasons:
        raise Unmeasured(reasons)


def _missing_entries(baseline: Measurement, run: Measurement) -> Iterator[str]:
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
            old, new = (str(getattr(side, key))[:80] for side in (then, now))
            yield (
                f"{name}: not run as for the baseline ({key}: '{old}' in the baseline, '{new}' in the run): compare"
                " with the command in the baseline, or make the baseline again with --update"
            )


def _other_units(baseline: Measurement, run: Measurement) -> Iterator[str]:
    usual: dict[str, int] = {}
    for label, name, then in baseline.trials():
        problem = _unit_mismatch(then, run.trackers[label].recordings[name])
        if not problem and len(then.units) != usual.setdefault(name, len(then.units)):
            problem = "its number of units is not that of the other trackers"
        if problem:
            yield f"{label}@{name}: {problem}, so the trials do not pair: make the baseline again with --update"


def _missing_measurements(baseline: Measurement, run: Measurement) -> Iterator[str]:
    """Measurements in addition to the scores are not judged here; a missing one is an error, so that none is lost."""
    for label, name, then in baseline.trials():
        for measurement in then.measurements:
            if measurement not in run.trackers[label].recordings[name].measurements:
                yield (
                    f"{label}@{name}: measured with --{measurement} for the baseline and not in the run: compare with"
                    " the command in the baseline, or make the baseline again with --update"
                )


def _unit_mismatch(then: TrialCounts, now: TrialCounts) -> str:
    """The reason why the units of two trials do not pair; empty where they do."""
    if len(then.units) != len(now.units):
        return f"{len(then.units)} units in the baseline, {len(now.units)} in the run"
    for one, other in zip(then.units, now.units, strict=True):
        if (one.frames, one.delivered) != (other.frames, other.delivered):
            return "other frames were delivered than for the baseline"
        if _cells_by_row(one.counts) != _cells_by_row(other.counts):
            return "other strata or cells were scored than for the baseline"
    return ""


def _cells_by_row(
    counts: dict[str, dict[str, tuple[int, int, int, int, float]]],
) -> dict[tuple[str, str], tuple[int, int]]:
    """Occupied and free cells by stratum and band: they follow from the frames and not from the forecasts."""
    return {
        (stratum, band): (tp + fn, fp + tn)
        for stratum, bands in counts.items()
        for band, (tp, fp, fn, tn, _) in bands.items()
    }


def _paired_rows(label: str, baseline: Baseline, run: Measurement) -> Iterator[PairedRow]:
    """The rows of one tracker over the units of every recording; without cells in a stratum the counts are zero."""
    *then, now = (side.trackers[label].recordings for side in (*baseline.runs, run))
    units = [(name, unit) for name, trial in then[0].items() for unit in range(len(trial.units))]
    names = tuple(name for name, _ in units)
    strata = dict.fromkeys(s for name, unit in units for s in now[name].units[unit].counts)
    bands = {band for name, unit in units for found in now[name].units[unit].counts.values() for band in found}
    no_counts = (0, 0, 0, 0, 0.0)
    for stratum in strata:
        for band in (name for name in BANDS if name in bands):
            sides = [
                [side[name].units[unit].counts.get(stratum, {}).get(band, no_counts) for name, unit in units]
                for side in (*then, now)
            ]
            *old, new = np.array(sides, float)
            trainings = np.stack(old)
            yield PairedRow(label, stratum, band, trainings[..., :4], new[:, :4], trainings[..., 4], new[:, 4], names)
