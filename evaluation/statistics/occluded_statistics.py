"""Occluded cells at three thresholds: each tracker's F1 and log loss there less those of the reference.

The threshold of the stratum is chosen with the truth of hidden cells, which no user has. At the threshold of visible
cells, or at 0.5, the ranking may be another one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gridtrack.evaluation.results.summary import ORACLE, OccludedDifference, ScoreDifference
from gridtrack.evaluation.results.values import rounded_curve, rounded_p_curve
from gridtrack.evaluation.scoring.histograms import read_called
from gridtrack.evaluation.scoring.strata import OCCLUDED
from gridtrack.evaluation.scoring.thresholds import bins_of
from gridtrack.evaluation.statistics.finished_trial import FinishedTrial
from gridtrack.evaluation.statistics.frame_counts import FrameCounts
from gridtrack.evaluation.statistics.jackknife import COUNTS
from gridtrack.evaluation.statistics.paired_ratios import paired_ratios
from gridtrack.evaluation.statistics.run_statistics import RunStatistics

OCCLUDED_SCORES = ("f1", "f1_at_visible", "f1_at_half", "nll")
"""F1 at the threshold chosen with the truth, at that of visible cells and at 0.5, and the log loss, which has none."""
_TP, _FP, _FN, _TN, _LOSS = (COUNTS.index(name) for name in ("tp", "fp", "fn", "tn", "log_loss"))


class OccludedStatistics:
    """Differences on occluded cells, with the statistical units and the reference of the other scores of a run."""

    def __init__(self, statistics: RunStatistics) -> None:
        self._statistics = statistics
        self._counts: dict[str, FrameCounts] = {}

    def differences(self) -> list[OccludedDifference]:
        """Each comparable tracker less the reference, on all recordings if pooled, else on each. Raises ScoresError."""
        found = []
        for names in self._statistics.groups:
            rows = {label: self._statistics.comparable(label, names) for label in self._statistics.labels}
            whole = {label: trials for label, trials in rows.items() if _comparable(trials, names)}
            reference = whole.pop(self._statistics.reference or "", None)
            if reference is not None:
                found += [self._difference(trials, reference, names) for trials in whole.values()]
        return found

    def _difference(
        self, own: Sequence[FinishedTrial], others: Sequence[FinishedTrial], names: Sequence[str]
    ) -> OccludedDifference:
        paired = paired_ratios(self._statistics, own, others, names, self._counts_of)
        found = paired.found
        if found is None:
            return OccludedDifference(**paired.described)
        scores = {
            name: ScoreDifference(
                value=rounded_curve(found.value[:, i]),
                low=rounded_curve(found.low[:, i]),
                high=rounded_curve(found.high[:, i]),
                p=rounded_p_curve(found.p[:, i]),
            )
            for i, name in enumerate(OCCLUDED_SCORES)
        }
        return OccludedDifference(**paired.described, scores=scores)

    def _counts_of(self, trial: FinishedTrial) -> FrameCounts:
        """Numerator and denominator of the scores at each scored frame and step of the trial, and the cells that define
        them, read once: counts (F, S, K, 3), K as OCCLUDED_SCORES. F1 is undefined without an occupied cell.
        """
        key = trial.folder.name
        if key not in self._counts:
            frames = self._statistics.frames_of(trial)
            own = frames.counts[:, :, trial.strata.index(OCCLUDED)]
            steps, used = trial.record.steps, trial.record.thresholds.values
            thresholds = np.array([used["visible"], [0.5] * (steps + 1)])
            called = read_called(trial.folder, frames.stamps_ns, steps, OCCLUDED, bins_of(thresholds))
            positives = own[..., _TP] + own[..., _FN]
            parts = [2 * own[..., _TP], *(2 * called[..., 1])]
            wholes = [parts[0] + own[..., _FP] + own[..., _FN], *(called[..., 0] + positives)]
            parts.append(own[..., _LOSS])
            wholes.append(positives + own[..., _FP] + own[..., _TN])
            to_find = [*(positives for _ in parts[:-1]), wholes[-1]]
            counts = np.stack([np.stack(one, axis=-1) for one in (parts, wholes, to_find)], axis=-1)
            self._counts[key] = FrameCounts(frames.stamps_ns, frames.delivered, counts.astype(np.float32))
        return self._counts[key].of_steps(trial)


def _comparable(trials: Sequence[FinishedTrial], names: Sequence[str]) -> bool:
    """Whether these are trials of a tracker, on every recording, with scores on occluded cells."""
    whole = len(trials) == len(names)
    return whole and all(trial.tracker != ORACLE and OCCLUDED in trial.strata for trial in trials)
