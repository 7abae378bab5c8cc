"""The verdict on a run: which trackers are worse than in the baseline, in which strata and step bands, and how sure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from gridtrack.common.config import Settings
from gridtrack.common.errors import ConfigurationError, did_you_mean
from gridtrack.evaluation.regression.measurement import Measurement, Unmeasured
from gridtrack.evaluation.regression.pairing import PairedRow, pair
from gridtrack.evaluation.regression.significance import FAMILY_LEVEL, f1_of, fall_p_values
from gridtrack.evaluation.regression.speed import SpeedRow, judge_speed
from gridtrack.evaluation.statistics.uncertainty import LEAST_UNITS

Standing = Literal["worse", "no worse", "equal", "nothing to find"]
SMALLEST_FALL = 1e-9
"""A smaller fall in F1 is rounding."""

Margin = Annotated[float, Field(ge=0.0, lt=1.0)]


class GateSettings(Settings):
    """From which fall on a tracker is worse."""

    margin: Margin = 0.005
    """A fall in F1 that does not matter, however significant."""
    tolerance: dict[str, Margin] = Field(default_factory=dict)
    """By label, in place of the margin: how far two trainings of that tracker may lie apart. Where there are too few
    units for significance it decides alone, and a tracker without one must not fall at all."""
    speed_reference: str | None = None
    """The tracker that speed is measured against; None: speed is not judged."""
    speed_margin: Annotated[float, Field(ge=0.0)] = 0.5
    """By which share a tracker's time may grow, as a ratio to that of the reference."""


@dataclass(frozen=True, slots=True)
class Row:
    """One tracker, stratum and step band over all units; `recording` names one where the row is of that one only.

    F1 is pooled over steps and frames; None where nothing was occupied. `log_loss` is the mean of a cell, in nats.
    `p` is of the fall, corrected for the family; None where units are too few, and for one recording.
    """

    label: str
    stratum: str
    band: str
    recording: str
    f1_baseline: float | None
    f1_run: float | None
    log_loss_baseline: float | None
    log_loss_run: float | None
    margin: float
    p: float | None
    standing: Standing

    @property
    def fall(self) -> float:
        """By how much F1 fell; negative where it rose."""
        return 0.0 if self.f1_baseline is None or self.f1_run is None else self.f1_baseline - self.f1_run


@dataclass(frozen=True, slots=True)
class Verdict:
    """`rows` decide, over all units, and `speed` where it was asked for; `fallen` are each
    tracker's deepest falls on single recordings, told and not judged; `notes` are what else to know."""

    rows: tuple[Row, ...]
    fallen: tuple[Row, ...]
    speed: tuple[SpeedRow, ...]
    units: int
    significance: bool
    """Whether units were enough for it; else only equality and tolerances decide."""
    notes: tuple[str, ...]

    @property
    def decisive(self) -> tuple[Row | SpeedRow, ...]:
        """Every row that decides."""
        return (*self.rows, *self.speed)

    @property
    def worse(self) -> tuple[Row | SpeedRow, ...]:
        """The rows that are worse: with none, the run passes."""
        return tuple(row for row in self.decisive if row.standing == "worse")


def judge(baseline: Measurement, run: Measurement, settings: GateSettings | None = None) -> Verdict:
    """Compare a run with a baseline, paired by units.

    Raises Unmeasured where they do not pair or hold nothing to judge, ConfigurationError for a label that is unknown.
    """
    settings = settings or GateSettings()
    for label in (*settings.tolerance, *filter(None, [settings.speed_reference])):
        if label not in baseline.trackers:
            raise ConfigurationError(f"the baseline has no tracker '{label}'; {did_you_mean(label, baseline.trackers)}")
    paired = pair(baseline, run)
    units = len(paired[0].recordings) if paired else 0
    significance = units >= LEAST_UNITS
    p_values = _p_values(paired) if significance else dict.fromkeys(range(len(paired)))
    rows = tuple(_judged(row, settings, p_values[i], significance) for i, row in enumerate(paired))
    if all(row.standing == "nothing to find" for row in rows):
        raise Unmeasured(["no cell was occupied in any stratum and step band: nothing was measured"])
    speed, spoken = judge_speed(baseline, run, settings.speed_reference, settings.speed_margin)
    return Verdict(rows, _fallen(paired, settings), speed, units, significance, (*_notes(baseline, run), *spoken))


def _p_values(paired: Sequence[PairedRow]) -> dict[int, float]:
    """One family: every row of every tracker."""
    baseline = np.stack([row.baseline for row in paired], axis=1)
    run = np.stack([row.run for row in paired], axis=1)
    return dict(enumerate(fall_p_values(baseline, run).tolist()))


def _judged(row: PairedRow, settings: GateSettings, p: float | None, significance: bool) -> Row:
    """The row over all units, with its standing."""
    tolerance = settings.tolerance.get(row.label)
    margin = (settings.margin if significance else 0.0) if tolerance is None else tolerance
    plain = _row(row, np.ones(len(row.recordings), bool), "", margin, p)
    beyond = plain.fall > margin + SMALLEST_FALL and (p is None or p <= FAMILY_LEVEL)
    standing: Standing = "worse" if beyond and plain.standing == "no worse" else plain.standing
    return replace(plain, standing=standing)


def _row(row: PairedRow, members: NDArray[np.bool_], recording: str, margin: float, p: float | None) -> Row:
    """The row over some of its units, not judged yet."""
    then, now = row.baseline[members].sum(axis=0), row.run[members].sum(axis=0)
    f1_then, f1_now = (None if np.isnan(f1) else float(f1) for f1 in (f1_of(then), f1_of(now)))
    cells = then.sum() or np.nan
    loss_then, loss_now = (
        None if np.isnan(loss) else float(loss)
        for loss in (row.baseline_log_loss[members].sum() / cells, row.run_log_loss[members].sum() / cells)
    )
    standing: Standing = "no worse"
    if f1_then is None:
        standing = "nothing to find"
    elif np.array_equal(row.baseline[members], row.run[members]):
        standing = "equal"
    return Row(row.label, row.stratum, row.band, recording, f1_then, f1_now, loss_then, loss_now, margin, p, standing)


def _fallen(paired: Sequence[PairedRow], settings: GateSettings) -> tuple[Row, ...]:
    """The deepest fall of each tracker on each single recording, where it is beyond the margin; the deepest first."""
    deepest: dict[tuple[str, str], Row] = {}
    for row in paired:
        names = np.array(row.recordings)
        margin = settings.tolerance.get(row.label, settings.margin)
        for name in dict.fromkeys(row.recordings):
            one = _row(row, names == name, name, margin, None)
            known = deepest.get((row.label, name))
            if one.fall > margin and (known is None or one.fall > known.fall):
                deepest[row.label, name] = one
    return tuple(sorted(deepest.values(), key=lambda row: -row.fall))


def _notes(baseline: Measurement, run: Measurement) -> list[str]:
    """What differs between the two beside the counts."""
    notes = [
        f"tracker {label} is not in the baseline: not judged"
        for label in run.trackers
        if label not in baseline.trackers
    ]
    notes += [
        f"recording {name} is not in the baseline: not judged"
        for name in run.recordings
        if name not in baseline.recordings
    ]
    for label, then in baseline.trackers.items():
        now = run.trackers[label]
        if (then.tracker, then.options) != (now.tracker, now.options):
            notes.append(f"{label} was {_named(then.tracker, then.options)}, now {_named(now.tracker, now.options)}")
        others = [r for r, trial in then.recordings.items() if trial.weights_sha256 != now.recordings[r].weights_sha256]
        if others:
            notes.append(
                f"{label} has other weights than in the baseline on {len(others)} of {len(then.recordings)} recordings"
            )
    changed = [
        f"{name} {old}, now {run.versions.get(name, 'none')}"
        for name, old in baseline.versions.items()
        if run.versions.get(name) != old
    ]
    return [*notes, *([f"versions: {'; '.join(changed)}"] if changed else [])]


def _named(tracker: str, options: Mapping[str, object]) -> str:
    return tracker + "".join(f" {key}={value}" for key, value in options.items())
