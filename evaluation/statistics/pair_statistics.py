"""Which rows of a run are told apart: all pairs tested on the units of all, each score with Holm's correction."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.results.summary import ALL_RECORDINGS, ORACLE, PairFamily, PairTest
from gridtrack.evaluation.results.trial_summary import better_direction
from gridtrack.evaluation.results.values import rounded, rounded_p
from gridtrack.evaluation.statistics.finished_trial import FinishedTrial
from gridtrack.evaluation.statistics.frame_counts import FrameCounts, common_frames
from gridtrack.evaluation.statistics.jackknife import (
    LEAST_UNITS,
    Floats,
    PairedDifferences,
    differences,
    holm,
    ratio_differences,
)
from gridtrack.evaluation.statistics.paired_tests import verdict_of
from gridtrack.evaluation.statistics.run_statistics import RunStatistics
from gridtrack.evaluation.statistics.score_intervals import Scope
from gridtrack.evaluation.statistics.trial_files import HeadlineSums, TrialFiles
from gridtrack.evaluation.statistics.units import sum_by_unit

PAIR_SCORES = ("f1", "pr_auc", "nll", "fss_5", "soft_iou", "beam_error")
"""The scores by which pairs are tested."""


@dataclass(frozen=True, slots=True)
class _Row:
    """One row on the frames that all rows have, in units: counts (U, N, C), and the sums of other scores."""

    label: str
    counts: Floats
    sums: HeadlineSums

    def less(self, other: _Row, score: str) -> PairedDifferences | None:
        """The differences (N,) in a score; None where a row lacks it."""
        if score in ("f1", "nll"):
            return differences(self.counts, other.counts, score)
        if score == "pr_auc":
            return self.sums.pr_auc.less(other.sums.pr_auc)
        own, others = self.sums.spatial, other.sums.spatial
        if score in own and score in others:
            return ratio_differences(own[score], others[score])
        return None


class PairStatistics:
    """All pairs of the rows that may be compared: complete on every recording, learned from none of their frames."""

    def __init__(self, statistics: RunStatistics) -> None:
        self._statistics = statistics

    def families(self) -> list[PairFamily]:
        """A family for each score, stratum and horizon of the headline, on what trackers are compared on together.

        Rows of raw returns are compared among themselves. Nothing with fewer than LEAST_UNITS units, or where rows
        have no frame in common. Raises ScoresError.
        """
        return [family for names in self._statistics.groups for family in self._on(names)]

    def _on(self, names: Sequence[str]) -> Iterator[PairFamily]:
        labels = [label for label in self._statistics.labels if label != ORACLE]
        found = {label: self._statistics.comparable(label, names) for label in labels}
        whole = {label: trials for label, trials in found.items() if len(trials) == len(names)}
        for points in dict.fromkeys(trials[0].points for trials in whole.values()):
            rows = {label: trials for label, trials in whole.items() if trials[0].points == points}
            if len(rows) > 1:
                yield from self._among(rows, names)

    def _among(self, rows: dict[str, list[FinishedTrial]], names: Sequence[str]) -> Iterator[PairFamily]:
        scope = self._statistics.scope(names, [trial for trials in rows.values() for trial in trials])
        counted = {
            label: [self._statistics.frames_in(trial, scope.strata) for trial in trials]
            for label, trials in rows.items()
        }
        shared = [reduce(_kept, of_recording) for of_recording in zip(*counted.values(), strict=True)]
        units = self._statistics.unit_rule(names).units_of([one.stamps_ns for one in shared])
        number = len({int(unit) for one in units for unit in one})
        if number < LEAST_UNITS or not scope.headline:
            return
        files = self._statistics.files
        summed = [_row(label, rows[label], counted[label], shared, units, scope, files) for label in rows]
        recordings = ALL_RECORDINGS if len(names) > 1 else names[0]
        yield from _families(summed, scope, recordings, number)


def _kept(one: FrameCounts, other: FrameCounts) -> FrameCounts:
    """The frames of `one` that `other` has too."""
    return common_frames(one, other)[0]


def _row(
    label: str,
    trials: Sequence[FinishedTrial],
    counted: Sequence[FrameCounts],
    shared: Sequence[FrameCounts],
    units: Sequence[NDArray[np.int64]],
    scope: Scope,
    files: TrialFiles,
) -> _Row:
    """The sums of one row over the `shared` frames, which are in these `units`. Raises ScoresError."""
    chosen = [(step, stratum) for stratum, _, step in scope.headline]
    counts = sum_by_unit([_kept(own, one).counts for own, one in zip(counted, shared, strict=True)], units)
    at = [counts[:, step, scope.strata.index(stratum)] for step, stratum in chosen]
    return _Row(
        label, np.stack(at, axis=1), files.headline_sums(trials, [one.stamps_ns for one in shared], units, chosen)
    )


def _families(rows: Sequence[_Row], scope: Scope, recordings: str, units: int) -> Iterator[PairFamily]:
    pairs = list(combinations(rows, 2))
    for score in PAIR_SCORES:
        found = [one.less(other, score) for one, other in pairs]
        made = [(pair, found_in) for pair, found_in in zip(pairs, found, strict=True) if found_in is not None]
        for i, (stratum, horizon_s, step) in enumerate(scope.headline):
            adjusted = holm(np.array([found_in.p[i] for _, found_in in made])).tolist()
            tests = (
                pair_test(one.label, other.label, found_in.at(i), p_holm, score)
                for ((one, other), found_in), p_holm in zip(made, adjusted, strict=True)
                if not np.isnan(p_holm)
            )
            if tested := tuple(tests):
                yield PairFamily(
                    recordings=recordings,
                    score=score,
                    stratum=stratum,
                    horizon_s=round(horizon_s, 6),
                    step=step,
                    units=units,
                    pairs=tested,
                )


def pair_test(tracker: str, other: str, found: PairedDifferences, p_holm: float, score: str) -> PairTest:
    """The test of one pair for the summary; `found` is one difference, `p_holm` its corrected p-value."""
    value = float(found.value)
    return PairTest(
        tracker=tracker,
        other=other,
        difference=rounded(value),
        low=rounded(float(found.low)),
        high=rounded(float(found.high)),
        p=rounded_p(float(found.p)),
        p_holm=rounded_p(p_holm),
        verdict=verdict_of(better_direction(score) * value, p_holm),
    )
