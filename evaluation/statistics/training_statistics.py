"""Several trainings of a tracker in one run: the spread of its scores, and differences that are judged with it.

Rows of the same tracker, options and points that differ in their weights, on any recording, are trainings of one
tracker.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gridtrack.evaluation.results.summary import ALL_RECORDINGS, ORACLE, TrackerTrainings, TrainingsScore
from gridtrack.evaluation.results.values import rounded, rounded_p
from gridtrack.evaluation.statistics.finished_trial import FinishedTrial
from gridtrack.evaluation.statistics.jackknife import LEAST_UNITS, Floats, PairedDifferences, holm, ratio_sums
from gridtrack.evaluation.statistics.paired_tests import OTHER_FRAMES, OTHER_RETURNS, verdict_of
from gridtrack.evaluation.statistics.run_statistics import RunStatistics
from gridtrack.evaluation.statistics.score_intervals import Scope, summed_by_unit
from gridtrack.evaluation.statistics.training_differences import LEAST_TRAININGS, Trainings, training_differences
from gridtrack.evaluation.statistics.training_spread import spread_between, value_of

_ByWeights = dict[tuple[str, ...], list[FinishedTrial]]
"""Rows of one tracker by the hashes of their weights on each recording."""
FEW_TRAININGS = f"fewer than {LEAST_TRAININGS} trainings: the spread between them is hardly known"


@dataclass(frozen=True, slots=True)
class _Trained:
    """What all trainings of one tracker have in common."""

    tracker: str
    options: str
    points: str

    @classmethod
    def of(cls, trial: FinishedTrial) -> _Trained:
        return cls(trial.tracker, json.dumps(dict(trial.options), sort_keys=True, default=str), trial.points)


@dataclass(frozen=True, slots=True)
class TrainingRows:
    """The rows of one tracker on the recordings `names`, and those of the reference: the trials of each training.

    `why_partial`: that one of the two has trainings which did not complete these recordings, and may be its worse ones.
    """

    names: tuple[str, ...]
    own: Sequence[Sequence[FinishedTrial]]
    reference: Sequence[Sequence[FinishedTrial]]
    why_partial: str


class TrainingStatistics:
    """The trackers of a run by their trainings, where a tracker has several."""

    def __init__(self, statistics: RunStatistics) -> None:
        self._statistics = statistics

    def found(self) -> list[TrackerTrainings]:
        """Every tracker with its trainings: over all recordings if pooled, else on each. Raises ScoresError."""
        rows = [one for names in self._statistics.groups for one in self._rows_on(names)]
        compared = [self._compared(one) for one in rows]
        ends = np.cumsum([0, *(len(one.differences.p) for one in compared)]).tolist()
        p = holm(np.concatenate([np.zeros(0), *(one.differences.p for one in compared)]))
        return [
            self._described(of, one, p[start:end])
            for of, one, start, end in zip(rows, compared, ends, ends[1:], strict=False)
        ]

    def _rows_on(self, names: Sequence[str]) -> list[TrainingRows]:
        """The trackers on these recordings by their trainings; none where no tracker has several."""
        statistics = self._statistics
        groups: dict[tuple[_Trained, str], _ByWeights] = {}
        group_of: dict[str | None, tuple[_Trained, str]] = {}
        for label in statistics.labels:
            trials = statistics.comparable(label, names)
            if len(trials) == len(names) and trials[0].tracker != ORACLE:
                group = group_of[label] = _Trained.of(trials[0]), trials[0].record.card
                groups.setdefault(group, {}).setdefault(_weights(trials), trials)
        of_reference = group_of.get(statistics.reference)
        if of_reference is None or all(len(one) == 1 for one in groups.values()):
            return []
        failed = self._failed(names)
        rows = {group: list(of_group.values()) for group, of_group in groups.items()}
        why = {group: _why_partial(group[0].tracker, len(rows[group]), failed[group[0]]) for group in groups}
        return [
            TrainingRows(tuple(names), own, rows[of_reference], why[group] or why[of_reference])
            for group, own in rows.items()
        ]

    def _failed(self, names: Sequence[str]) -> Counter[_Trained]:
        """The number of rows of each tracker that did not complete these recordings."""
        rows = [self._statistics.trials_of(label, names) for label in self._statistics.labels]
        return Counter(_Trained.of(trials[0]) for trials in rows if trials and not all(t.complete for t in trials))

    def _compared(self, rows: TrainingRows) -> _Compared:
        """The scores of the trainings, and their differences from the reference's."""
        scope = self._statistics.scope(rows.names, [*rows.own[0], *rows.reference[0]])
        own, why = self._trainings(rows.own, scope, rows.names), rows.why_partial or self._why_unpaired(rows)
        if why or rows.own is rows.reference:
            nothing = np.full(own.sums.shape[2], np.nan)
            return _Compared(scope, own, PairedDifferences(*(nothing.copy() for _ in range(4))), why)
        reference = self._trainings(rows.reference, scope, rows.names)
        units = own.sums.shape[1]
        if units < LEAST_UNITS:
            why = self._statistics.unit_rule(rows.names).too_short(units)
        elif not (own.spread_known and reference.spread_known):
            why = FEW_TRAININGS
        return _Compared(scope, own, training_differences(own, reference), why)

    def _why_unpaired(self, rows: TrainingRows) -> str:
        if rows.own[0][0].points != rows.reference[0][0].points:
            return OTHER_RETURNS
        return OTHER_FRAMES if len({self._frames(one) for one in (*rows.own, *rows.reference)}) > 1 else ""

    def _frames(self, trials: Sequence[FinishedTrial]) -> tuple[bytes, ...]:
        """What tells whether two rows were scored on the same frames."""
        frames = map(self._statistics.frames_of, trials)
        return tuple(one.stamps_ns.tobytes() + one.delivered.tobytes() for one in frames)

    def _trainings(self, rows: Sequence[Sequence[FinishedTrial]], scope: Scope, names: Sequence[str]) -> Trainings:
        """F1 of the rows at the headline's strata and horizons."""
        rule = self._statistics.unit_rule(names)
        steps = [step for _, _, step in scope.headline]
        strata = [scope.strata.index(stratum) for stratum, _, _ in scope.headline]
        sums = []
        for trials in rows:
            (counts,), _ = summed_by_unit([[self._statistics.frames_in(t, scope.strata) for t in trials]], rule)
            sums.append(np.stack(ratio_sums(counts[:, steps, strata], "f1"), axis=-1))
        return Trainings(np.stack(sums), learned=any(_weights(rows[0])))

    def _described(self, rows: TrainingRows, compared: _Compared, p_holm: Floats) -> TrackerTrainings:
        names, own, found = rows.names, compared.own, compared.differences
        f1 = value_of(own.sums.sum(axis=1))
        spread = spread_between(own.sums).deviation if len(f1) > 1 else np.full(f1.shape[1], np.nan)
        is_reference = rows.own is rows.reference
        return TrackerTrainings(
            recordings=ALL_RECORDINGS if len(names) > 1 else names[0],
            tracker=rows.own[0][0].tracker,
            labels=tuple(map(_label, rows.own)),
            reference=_label(rows.reference[0]),
            units=own.sums.shape[1],
            interval=compared.why,
            scores=tuple(
                TrainingsScore(
                    stratum=stratum,
                    horizon_s=round(horizon_s, 6),
                    step=step,
                    f1=tuple(rounded(float(value)) for value in f1[:, i]),
                    f1_mean=rounded(float(own.mean[i])),
                    f1_spread=rounded(float(spread[i])),
                    difference=rounded(float(found.value[i])),
                    difference_low=rounded(float(found.low[i])),
                    difference_high=rounded(float(found.high[i])),
                    difference_p=rounded_p(float(found.p[i])),
                    p_holm=rounded_p(float(p_holm[i])),
                    verdict="" if is_reference else verdict_of(float(found.value[i]), float(p_holm[i])),
                )
                for i, (stratum, horizon_s, step) in enumerate(compared.scope.headline)
            ),
        )


@dataclass(frozen=True, slots=True)
class _Compared:
    """The trainings of one tracker in a scope, their differences from the reference's, and why there are none."""

    scope: Scope
    own: Trainings
    differences: PairedDifferences
    why: str


def _why_partial(tracker: str, complete: int, failed: int) -> str:
    """Why a tracker with `failed` trainings is not compared; empty where all are complete."""
    if not failed:
        return ""
    return f"{complete} of {complete + failed} trainings of {tracker} are complete, and the others may be worse"


def _label(trials: Sequence[FinishedTrial]) -> str:
    return trials[0].record.label


def _weights(trials: Sequence[FinishedTrial]) -> tuple[str, ...]:
    """The hash of the weights of each trial of a row; empty texts of a tracker without weights."""
    return tuple(trial.record.weights_sha256 for trial in trials)
