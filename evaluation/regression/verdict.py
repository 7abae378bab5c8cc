"""The verdict on a run: the trackers that are worse than in the baseline, by score, stratum and step band."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from gridtrack.common.errors import ConfigurationError, did_you_mean
from gridtrack.evaluation.regression.judging import RowVerdict, VerdictRow, judged_recordings, judged_row
from gridtrack.evaluation.regression.measurement import Baseline, Measurement
from gridtrack.evaluation.regression.pairing import require_paired
from gridtrack.evaluation.regression.recoveries import RecoveryRow, compare_recoveries
from gridtrack.evaluation.regression.rows import paired_rows, row_tests
from gridtrack.evaluation.regression.settings import GateSettings
from gridtrack.evaluation.regression.speed import SpeedRow, TurnsRow, compare_speed
from gridtrack.evaluation.scores.registry import scores
from gridtrack.evaluation.statistics.jackknife import LEAST_UNITS

Standing = RowVerdict | Literal["not confirmed"]
AnyRow = VerdictRow | RecoveryRow | SpeedRow | TurnsRow


@dataclass(frozen=True, slots=True)
class SecondLook:
    """A worse row, and the same row of a second run of its trials; None if that run has no such row."""

    first: AnyRow
    second: AnyRow | None

    @property
    def confirmed(self) -> bool:
        """Whether it was worse again."""
        return self.second is not None and self.second.verdict == "worse"


@dataclass(frozen=True, slots=True)
class Verdict:
    """The verdict on a run.

    `rows` (over all units), the collapses among `on_recordings`, `recoveries`, `speed` and `turns` decide.
    `on_recordings` has the worst fall of each tracker on single recordings; `notes` has other differences.
    """

    rows: tuple[VerdictRow, ...]
    on_recordings: tuple[VerdictRow, ...]
    recoveries: tuple[RecoveryRow, ...]
    speed: tuple[SpeedRow, ...]
    units: int
    trainings: int
    """Number of runs of the baseline; with one, the spread between trainings is not known."""
    significance: bool
    """Whether there are enough units for p-values; else only equality and margins decide."""
    notes: tuple[str, ...]
    second_looks: tuple[SecondLook, ...] = ()
    """One for each worse row, if a confirmation was requested."""
    turns: tuple[TurnsRow, ...] = ()
    """Times measured in turns with a base, if requested."""
    below_best: tuple[VerdictRow, ...] = ()
    """Scores over all units that are worse than in the best entry of the history, but not than in the baseline."""
    floors: tuple[str, ...] = ()
    """Labels of the rows that every tracker must beat."""

    @property
    def collapses(self) -> tuple[VerdictRow, ...]:
        """The falls on single recordings that are worse."""
        return tuple(row for row in self.on_recordings if row.verdict == "worse")

    @property
    def decisive(self) -> tuple[AnyRow, ...]:
        """Every row that decides."""
        return (*self.rows, *self.below_best, *self.collapses, *self.recoveries, *self.speed, *self.turns)

    @property
    def worse(self) -> tuple[AnyRow, ...]:
        """The worse rows: scores first, the largest fall first. The run passes if there are none."""
        found = (row for row in self.decisive if self.standing_of(row) == "worse")
        return tuple(sorted(found, key=lambda row: -row.severity if isinstance(row, VerdictRow) else 0.0))

    def standing_of(self, row: AnyRow) -> Standing:
        """The verdict on a row; `not confirmed` if it was worse only in the first run."""
        refuted = any(look.first == row and not look.confirmed for look in self.second_looks)
        return "not confirmed" if refuted else row.verdict


def compare_with_baseline(
    baseline: Baseline,
    run: Measurement,
    settings: GateSettings | None = None,
) -> Verdict:
    """The verdict on `run`, paired with `baseline` by units.

    Raises Unmeasured if they do not pair, ConfigurationError for an unknown label.
    """
    settings = settings or GateSettings()
    for label in (*settings.tolerance, *filter(None, [settings.speed_reference])):
        known = baseline.first.trackers
        if label not in known:
            raise ConfigurationError(f"the baseline has no tracker '{label}'; {did_you_mean(label, known)}")
    require_paired(baseline, run)
    paired = paired_rows(baseline, run, scores(settings.scores))
    tests = row_tests(paired)
    rows = tuple(judged_row(row, test, settings) for row, test in zip(paired, tests, strict=True))
    speed, speed_notes = compare_speed(baseline, run, settings.speed_reference, settings.ratio_margin)
    units = len(np.unique(paired[0].units)) if paired else 0
    return Verdict(
        rows,
        judged_recordings(paired, tests, settings),
        compare_recoveries(baseline, run),
        speed,
        units,
        len(baseline.runs),
        units >= LEAST_UNITS,
        (*_notes(baseline, run), *speed_notes),
        floors=tuple(label for label, entry in run.trackers.items() if entry.role == "floor"),
    )


def _notes(baseline: Baseline, run: Measurement) -> list[str]:
    """Differences between baseline and run other than scores."""
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
