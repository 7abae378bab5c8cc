"""Statistics of class probabilities: scores, intervals of the log loss, and each tracker against a reference."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

from gridtrack.evaluation.results.columns import SEMANTICS_TABLE
from gridtrack.evaluation.results.recording import RecordingDescription
from gridtrack.evaluation.results.summary import ClassDifference, ClassLossCurves
from gridtrack.evaluation.results.trial_summary import SemanticScores
from gridtrack.evaluation.results.values import rounded_curve, rounded_p_curve
from gridtrack.evaluation.scoring.class_scores import ScoresByClass, class_scores
from gridtrack.evaluation.scoring.class_store import read_scan_losses
from gridtrack.evaluation.scoring.semantics import VISIBILITIES
from gridtrack.evaluation.statistics.finished_trial import FinishedTrial
from gridtrack.evaluation.statistics.frame_counts import FrameCounts
from gridtrack.evaluation.statistics.jackknife import LEAST_UNITS, ratio_interval
from gridtrack.evaluation.statistics.paired_ratios import paired_ratios
from gridtrack.evaluation.statistics.run_statistics import RunStatistics
from gridtrack.evaluation.statistics.score_intervals import summed_by_unit


class ClassStatistics:
    """Statistics of the class probabilities of a run, with the statistical units of its other scores.

    As with those, trackers are compared on the frames that both were scored on.
    """

    def __init__(self, recordings: Mapping[str, RecordingDescription], statistics: RunStatistics) -> None:
        self._recordings = recordings
        self._statistics = statistics
        self._losses: dict[str, FrameCounts] = {}

    def scores(self, trials: Sequence[FinishedTrial], names: Sequence[str]) -> ScoresByClass:
        """Scores by class of `trials`, pooled, with intervals; `names` are the recordings of the trials.

        Empty where the recordings have different classes. Raises ScoresError.
        """
        classes = self._recordings[names[0]].classes if self._same_classes(names) else ()
        counted = [(t.record, t.folder, t.steps) for t in trials]
        scores = class_scores(counted, classes, self._statistics.horizons_of(names))
        if scores.semantics is None:
            return scores
        scored = [trial for trial in trials if trial.record.frames_scored]
        return ScoresByClass(scores.recall_by_class, self._with_intervals(scores.semantics, scored))

    def differences(self) -> list[ClassDifference]:
        """Log loss of each tracker's classes less the reference's: over all recordings if pooled, else on each.

        Only trackers with class probabilities on every recording are compared; empty where the reference has none.
        """
        found = []
        for names in self._statistics.groups:
            rows = {label: self._with_classes(label, names) for label in self._statistics.labels}
            rows = {label: trials for label, trials in rows.items() if len(trials) == len(names)}
            reference = self._reference(rows)
            if reference is not None and self._same_classes(names):
                found += [self._difference(rows[label], rows[reference], names) for label in rows if label != reference]
        return found

    def _with_classes(self, label: str, names: Sequence[str]) -> list[FinishedTrial]:
        """The comparable trials of one row on these recordings that have class probabilities."""
        return [trial for trial in self._statistics.comparable(label, names) if _has_classes(trial)]

    def _reference(self, rows: Mapping[str, Sequence[FinishedTrial]]) -> str | None:
        """The label of the reference for classes, of the rows with class probabilities; None where there is no row.

        It is the reference of the run, else the first tracker whose description has that role, else the first row.
        """
        described = [label for label, trials in rows.items() if "classes" in trials[0].record.reference_for]
        requested = [label for label in rows if label == self._statistics.reference]
        return next(iter([*requested, *described, *rows]), None)

    def _with_intervals(self, semantics: SemanticScores, trials: Sequence[FinishedTrial]) -> SemanticScores:
        """`semantics` with the intervals of the log loss per scan; without intervals, `interval` is the reason."""
        names = [trial.record.recording for trial in trials]
        rule = self._statistics.unit_rule(names)
        (losses,), units = summed_by_unit([[self._losses_of(trial) for trial in trials]], rule)
        if units < LEAST_UNITS:
            why = rule.too_short(units)
            ends: dict[str, dict[str, Any]] = {visibility: {"interval": why} for visibility in VISIBILITIES}
        else:
            low, high = ratio_interval(losses[..., 0], losses[..., 1])
            ends = {
                visibility: {
                    "nll_per_scan_low": rounded_curve(low[:, i]),
                    "nll_per_scan_high": rounded_curve(high[:, i]),
                }
                for i, visibility in enumerate(VISIBILITIES)
            }
        kinds = {kind: scores.model_copy(update=ends[kind]) for kind, scores in semantics.kinds.items()}
        return semantics.model_copy(update={"kinds": kinds})

    def _difference(
        self, own: Sequence[FinishedTrial], others: Sequence[FinishedTrial], names: Sequence[str]
    ) -> ClassDifference:
        paired = paired_ratios(self._statistics, own, others, names, self._losses_of)
        found = paired.found
        if found is None:
            return ClassDifference(**paired.described)
        kinds = {
            visibility: ClassLossCurves(
                nll_per_scan=rounded_curve(found.value[:, i]),
                nll_per_scan_low=rounded_curve(found.low[:, i]),
                nll_per_scan_high=rounded_curve(found.high[:, i]),
                nll_per_scan_p=rounded_p_curve(found.p[:, i]),
            )
            for i, visibility in enumerate(VISIBILITIES)
        }
        return ClassDifference(**paired.described, kinds=kinds)

    def _losses_of(self, trial: FinishedTrial) -> FrameCounts:
        """Log loss of a trial at each scored frame, read once: counts (F, S, V, 2), V as VISIBILITIES.

        The last axis is the mean loss over the cells of the scan whose class is known, and 1; 0 and 0 without any.
        """
        key = trial.folder.name
        if key not in self._losses:
            frames = self._statistics.frames_of(trial)
            losses = read_scan_losses(trial.folder, frames.stamps_ns, trial.record.steps)
            self._losses[key] = FrameCounts(frames.stamps_ns, frames.delivered, losses)
        return self._losses[key].of_steps(trial)

    def _same_classes(self, names: Sequence[str]) -> bool:
        """Whether the recordings have the same classes, at least one."""
        classes = [self._recordings[name].classes for name in names]
        return bool(classes[0]) and all(one == other for one, other in pairwise(classes))


def _has_classes(trial: FinishedTrial) -> bool:
    return (trial.folder / SEMANTICS_TABLE.file).exists()
