"""The verdict on a run: the trackers that are worse than in the baseline, by stratum and step band."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.errors import ConfigurationError, did_you_mean
from gridtrack.evaluation.regression.measurement import Baseline, Measurement, Unmeasured
from gridtrack.evaluation.regression.p_values import RowPValue, row_p_values
from gridtrack.evaluation.regression.pairing import PairedRow, pair
from gridtrack.evaluation.regression.settings import GateSettings
from gridtrack.evaluation.regression.significance import FAMILY_LEVEL
from gridtrack.evaluation.regression.speed import SpeedRow, compare_speed
from gridtrack.evaluation.scoring.metrics import f1_score
from gridtrack.evaluation.statistics.jackknife import LEAST_UNITS

RowVerdict = Literal["worse", "no worse", "equal", "nothing to find"]
SMALLEST_FALL = 1e-9
"""A smaller fall in F1 is rounding."""


@dataclass(frozen=True, slots=True)
class VerdictRow:
    """One tracker, stratum and step band over all units, or over those of `recording` where it is not empty.

    F1 is pooled over steps and frames; None where no cell was occupied. `log_loss` is the mean over cells, in nats.
    Both are of the mean counts where the baseline has several runs. `p`: the p-value of the fall, corrected for the
    family; None with too few units, and for a single recording. `spread`: the standard deviation of F1 between
    trainings; None where it is not known.
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
    spread: float | None
    verdict: RowVerdict

    @property
    def fall(self) -> float:
        """F1 of the baseline less that of the run; negative where F1 rose."""
        return 0.0 if self.f1_baseline is None or self.f1_run is None else self.f1_baseline - self.f1_run


@dataclass(frozen=True, slots=True)
class Verdict:
    """The verdict: `rows`, over all units, and `speed`, where requested, decide. `fallen`: the largest fall of each
    tracker on single recordings, shown and not judged; `notes`: other differences."""

    rows: tuple[VerdictRow, ...]
    fallen: tuple[VerdictRow, ...]
    speed: tuple[SpeedRow, ...]
    units: int
    trainings: int
    """Number of runs of the baseline; with one, the spread between trainings is not known."""
    significance: bool
    """Whether there are enough units for p-values; else only equality and tolerances decide."""
    notes: tuple[str, ...]

    @property
    def decisive(self) -> tuple[VerdictRow | SpeedRow, ...]:
        """Every row that decides."""
        return (*self.rows, *self.speed)

    @property
    def worse(self) -> tuple[VerdictRow | SpeedRow, ...]:
        """The rows that are worse; if there is none, the run passes."""
        return tuple(row for row in self.decisive if row.verdict == "worse")


def compare_with_baseline(baseline: Baseline, run: Measurement, settings: GateSettings | None = None) -> Verdict:
    """The verdict on `run`, paired with `baseline` by units.

    Raises Unmeasured where they do not pair or no cell was occupied, ConfigurationError for an unknown label.
    """
    settings = settings or GateSettings()
    for label in (*settings.tolerance, *filter(None, [settings.speed_reference])):
        known = baseline.first.trackers
        if label not in known:
            raise ConfigurationError(f"the baseline has no tracker '{label}'; {did_you_mean(label, known)}")
    paired = pair(baseline, run)
    units = len(paired[0].recordings) if paired else 0
    rows = tuple(_judged_row(row, settings, p_value) for row, p_value in zip(paired, row_p_values(paired), strict=True))
    if all(row.verdict == "nothing to find" for row in rows):
        raise Unmeasured(["no cell was occupied in any stratum and step band: nothing was measured"])
    speed, speed_notes = compare_speed(baseline, run, settings.speed_reference, settings.speed_margin)
    return Verdict(
        rows,
        _largest_falls(paired, settings),
        speed,
        units,
        len(baseline.runs),
        units >= LEAST_UNITS,
        (*_notes(baseline, run), *speed_notes),
    )


def _judged_row(row: PairedRow, settings: GateSettings, p_value: RowPValue) -> VerdictRow:
    """The row over all units, with its verdict."""
    tolerance = settings.tolerance.get(row.label)
    margin = (0.0 if p_value.p is None else settings.margin) if tolerance is None else tolerance
    over_all = _verdict_row(row, np.ones(len(row.recordings), bool), "", margin, p_value)
    beyond = over_all.fall > margin + SMALLEST_FALL and (p_value.p is None or p_value.p <= FAMILY_LEVEL)
    verdict: RowVerdict = "worse" if beyond and over_all.verdict == "no worse" else over_all.verdict
    return replace(over_all, verdict=verdict)


def _verdict_row(
    row: PairedRow, members: NDArray[np.bool_], recording: str, margin: float, p_value: RowPValue
) -> VerdictRow:
    """The row over the units `members`; its verdict is not `worse` before it is judged."""
    then, now = row.baseline[members].sum(axis=0), row.run[members].sum(axis=0)
    f1_then, f1_now = (None if np.isnan(f1) else float(f1) for f1 in (f1_score(then), f1_score(now)))
    cells = then.sum() or np.nan
    loss_then, loss_now = (
        None if np.isnan(loss) else float(loss)
        for loss in (row.log_losses.mean(axis=0)[members].sum() / cells, row.run_log_loss[members].sum() / cells)
    )
    verdict: RowVerdict = "no worse"
    if f1_then is None:
        verdict = "nothing to find"
    elif row.equal:
        verdict = "equal"
    return VerdictRow(
        row.label, row.stratum, row.band, recording, f1_then, f1_now, loss_then, loss_now, margin, p_value.p,
        p_value.spread, verdict,
    )  # fmt: skip


def _largest_falls(paired: Sequence[PairedRow], settings: GateSettings) -> tuple[VerdictRow, ...]:
    """The largest fall of each tracker on each recording, if it exceeds the margin; the largest first."""
    largest: dict[tuple[str, str], VerdictRow] = {}
    for row in paired:
        names = np.array(row.recordings)
        margin = settings.tolerance.get(row.label, settings.margin)
        for name in dict.fromkeys(row.recordings):
            one = _verdict_row(row, names == name, name, margin, RowPValue())
            known = largest.get((row.label, name))
            if one.fall > margin and (known is None or one.fall > known.fall):
                largest[row.label, name] = one
    return tuple(sorted(largest.values(), key=lambda row: -row.fall))


def _notes(baseline: Baseline, run: Measurement) -> list[str]:
    """The differences between the two in addition to the counts."""
    first = baseline.first
    notes = [
        f"tracker {label} is not in the baseline: not judged" for label in run.trackers if label not in first.trackers
    ]
    notes += [
        f"recording {name} is not in the baseline: not judged"
        for name in run.recordings
        if name not in first.recordings
    ]
    for label, then in first.trackers.items():
        now = run.trackers[label]
        if (then.tracker, then.options) != (now.tracker, now.options):
            notes.append(
                f"{label} was {_described(then.tracker, then.options)}, now {_described(now.tracker, now.options)}"
            )
        if others := _count_other_weights(label, baseline, run):
            notes.append(
                f"{label} has different weights from the baseline on {others} of {len(then.recordings)} recordings"
            )
    changed = [
        f"{name} {old}, now {run.versions.get(name, 'none')}"
        for name, old in first.versions.items()
        if run.versions.get(name) != old
    ]
    return [*notes, *([f"versions: {'; '.join(changed)}"] if changed else [])]


def _count_other_weights(label: str, baseline: Baseline, run: Measurement) -> int:
    """The number of recordings on which the run has weights that no run of the baseline has."""
    return sum(
        all(then.trackers[label].recordings[name].weights_sha256 != trial.weights_sha256 for then in baseline.runs)
        for name, trial in run.trackers[label].recordings.items()
        if name in baseline.first.recordings
    )


def _described(tracker: str, options: Mapping[str, object]) -> str:
    return tracker + "".join(f" {key}={value}" for key, value in options.items())
