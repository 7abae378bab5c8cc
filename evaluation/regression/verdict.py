"""The verdict on a run: which trackers are worse than in the baseline, in which strata and step bands, and how sure."""

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
from gridtrack.evaluation.statistics.uncertainty import LEAST_UNITS

RowVerdict = Literal["worse", "no worse", "equal", "nothing to find"]
SMALLEST_FALL = 1e-9
"""A smaller fall in F1 is rounding."""


@dataclass(frozen=True, slots=True)
class VerdictRow:
    """One tracker, stratum and step band over all units; `recording` names one where the row is of that one only.

    F1 is pooled over steps and frames; None where nothing was occupied. `log_loss` is the mean of a cell, in nats.
    Both are of the mean counts where the baseline is of several runs. `p` is of the fall, corrected for the family;
    None where units are too few, and for one recording. `spread` is the standard deviation of F1 from training to
    training; None where that is not known.
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
        """By how much F1 fell; negative where it rose."""
        return 0.0 if self.f1_baseline is None or self.f1_run is None else self.f1_baseline - self.f1_run


@dataclass(frozen=True, slots=True)
class Verdict:
    """`rows` decide, over all units, and `speed` where it was asked for; `fallen` are each
    tracker's deepest falls on single recordings, told and not judged; `notes` are what else to know."""

    rows: tuple[VerdictRow, ...]
    fallen: tuple[VerdictRow, ...]
    speed: tuple[SpeedRow, ...]
    units: int
    trainings: int
    """Of how many runs the baseline is; of one, what separates trainings is not known."""
    significance: bool
    """Whether units were enough for it; else only equality and tolerances decide."""
    notes: tuple[str, ...]

    @property
    def decisive(self) -> tuple[VerdictRow | SpeedRow, ...]:
        """Every row that decides."""
        return (*self.rows, *self.speed)

    @property
    def worse(self) -> tuple[VerdictRow | SpeedRow, ...]:
        """The rows that are worse: with none, the run passes."""
        return tuple(row for row in self.decisive if row.verdict == "worse")


def compare_with_baseline(baseline: Baseline, run: Measurement, settings: GateSettings | None = None) -> Verdict:
    """Compare a run with a baseline, paired by units.

    Raises Unmeasured where they do not pair or hold nothing to judge, ConfigurationError for a label that is unknown.
    """
    settings = settings or GateSettings()
    for label in (*settings.tolerance, *filter(None, [settings.speed_reference])):
        known = baseline.first.trackers
        if label not in known:
            raise ConfigurationError(f"the baseline has no tracker '{label}'; {did_you_mean(label, known)}")
    paired = pair(baseline, run)
    units = len(paired[0].recordings) if paired else 0
    rows = tuple(_judged(row, settings, chance) for row, chance in zip(paired, row_p_values(paired), strict=True))
    if all(row.verdict == "nothing to find" for row in rows):
        raise Unmeasured(["no cell was occupied in any stratum and step band: nothing was measured"])
    speed, spoken = compare_speed(baseline, run, settings.speed_reference, settings.speed_margin)
    return Verdict(
        rows,
        _fallen(paired, settings),
        speed,
        units,
        len(baseline.runs),
        units >= LEAST_UNITS,
        (*_notes(baseline, run), *spoken),
    )


def _judged(row: PairedRow, settings: GateSettings, chance: RowPValue) -> VerdictRow:
    """The row over all units, with its standing."""
    tolerance = settings.tolerance.get(row.label)
    margin = (0.0 if chance.p is None else settings.margin) if tolerance is None else tolerance
    plain = _row(row, np.ones(len(row.recordings), bool), "", margin, chance)
    beyond = plain.fall > margin + SMALLEST_FALL and (chance.p is None or chance.p <= FAMILY_LEVEL)
    verdict: RowVerdict = "worse" if beyond and plain.verdict == "no worse" else plain.verdict
    return replace(plain, verdict=verdict)


def _row(row: PairedRow, members: NDArray[np.bool_], recording: str, margin: float, chance: RowPValue) -> VerdictRow:
    """The row over some of its units, not judged yet."""
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
        row.label, row.stratum, row.band, recording, f1_then, f1_now, loss_then, loss_now, margin, chance.p,
        chance.spread, verdict,
    )  # fmt: skip


def _fallen(paired: Sequence[PairedRow], settings: GateSettings) -> tuple[VerdictRow, ...]:
    """The deepest fall of each tracker on each single recording, where it is beyond the margin; the deepest first."""
    deepest: dict[tuple[str, str], VerdictRow] = {}
    for row in paired:
        names = np.array(row.recordings)
        margin = settings.tolerance.get(row.label, settings.margin)
        for name in dict.fromkeys(row.recordings):
            one = _row(row, names == name, name, margin, RowPValue())
            known = deepest.get((row.label, name))
            if one.fall > margin and (known is None or one.fall > known.fall):
                deepest[row.label, name] = one
    return tuple(sorted(deepest.values(), key=lambda row: -row.fall))


def _notes(baseline: Baseline, run: Measurement) -> list[str]:
    """What differs between the two beside the counts."""
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
            notes.append(f"{label} was {_named(then.tracker, then.options)}, now {_named(now.tracker, now.options)}")
        if others := _other_weights(label, baseline, run):
            notes.append(
                f"{label} has other weights than in the baseline on {others} of {len(then.recordings)} recordings"
            )
    changed = [
        f"{name} {old}, now {run.versions.get(name, 'none')}"
        for name, old in first.versions.items()
        if run.versions.get(name) != old
    ]
    return [*notes, *([f"versions: {'; '.join(changed)}"] if changed else [])]


def _other_weights(label: str, baseline: Baseline, run: Measurement) -> int:
    """On how many recordings the run has weights that no run of the baseline had."""
    return sum(
        all(then.trackers[label].recordings[name].weights_sha256 != trial.weights_sha256 for then in baseline.runs)
        for name, trial in run.trackers[label].recordings.items()
        if name in baseline.first.recordings
    )


def _named(tracker: str, options: Mapping[str, object]) -> str:
    return tracker + "".join(f" {key}={value}" for key, value in options.items())
