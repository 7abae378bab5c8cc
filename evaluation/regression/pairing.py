"""Pairing a run with a baseline: the same frames, cells and thresholds' stretch, or it is said what differs."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.regression.measurement import BANDS, CourseKey, Measurement, TrialCounts, Unmeasured

Counts = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PairedRow:
    """One tracker, stratum and step band: TP, FP, FN, TN (U, 4) and log loss (U,) of the baseline and of the run in
    units U, and the recording that each unit is of."""

    label: str
    stratum: str
    band: str
    baseline: Counts
    run: Counts
    baseline_log_loss: Counts
    run_log_loss: Counts
    recordings: tuple[str, ...]

    @property
    def equal(self) -> bool:
        """Whether every count is as it was."""
        return bool(np.array_equal(self.baseline, self.run))


def pair(baseline: Measurement, run: Measurement) -> tuple[PairedRow, ...]:
    """Rows of everything that the baseline holds. Raises Unmeasured, with every reason why something does not pair."""
    reasons = [*_missing(baseline, run), *_other_courses(baseline, run)]
    if not reasons:
        reasons = list(_other_units(baseline, run))
    if reasons:
        raise Unmeasured(reasons)
    return tuple(row for label in baseline.trackers for row in _rows(label, baseline, run))


def _missing(baseline: Measurement, run: Measurement) -> Iterator[str]:
    for label in sorted(baseline.trackers.keys() - run.trackers.keys()):
        yield f"tracker {label} of the baseline is missing in the run: run it too, or make the baseline again"
    for name in sorted(baseline.recordings.keys() - run.recordings.keys()):
        yield f"recording {name} of the baseline is missing in the run: run it too, or make the baseline again"


def _other_courses(baseline: Measurement, run: Measurement) -> Iterator[str]:
    for name, then in baseline.recordings.items():
        now = run.recordings.get(name, then)
        differing = [key for key in CourseKey.model_fields if getattr(then, key) != getattr(now, key)]
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


def _rows(label: str, baseline: Measurement, run: Measurement) -> Iterator[PairedRow]:
    """The rows of one tracker over the units of every recording; a recording without a stratum counts nothing in it."""
    then, now = baseline.trackers[label].recordings, run.trackers[label].recordings
    units = [(name, unit) for name, trial in then.items() for unit in range(len(trial.units))]
    strata = dict.fromkeys(s for name, unit in units for s in then[name].units[unit].counts)
    bands = {band for name, unit in units for found in then[name].units[unit].counts.values() for band in found}
    nothing = (0, 0, 0, 0, 0.0)
    for stratum in strata:
        for band in (name for name in BANDS if name in bands):
            old, new = (
                np.array(
                    [side[name].units[unit].counts.get(stratum, {}).get(band, nothing) for name, unit in units], float
                )
                for side in (then, now)
            )
            names = tuple(name for name, _ in units)
            yield PairedRow(label, stratum, band, old[:, :4], new[:, :4], old[:, 4], new[:, 4], names)
