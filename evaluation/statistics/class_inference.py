"""Statistics of class probabilities: scores, intervals of the log loss, and each tracker against a reference."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

from gridtrack.evaluation.results.columns import SEMANTICS_TABLE
from gridtrack.evaluation.results.recording import RecordingDescription
from gridtrack.evaluation.results.summary import ALL_RECORDINGS, ClassDifference, ClassLossCurves
from gridtrack.evaluation.results.trial_summary import SemanticScores
from gridtrack.evaluation.results.values import rounded_curve, rounded_p_curve
from gridtrack.evaluation.scoring.class_scores import ScoresByClass, class_scores
from gridtrack.evaluation.scoring.class_store import read_scan_losses
from gridtrack.evaluation.scoring.semantics import VISIBILITIES
from gridtrack.evaluation.statistics.finished_trial import FinishedTrial
from gridtrack.evaluation.statistics.frame_counts import FrameCounts, common_frames
from gridtrack.evaluation.statistics.inference import Inference
from gridtrack.evaluation.statistics.pooling import OTHER_FRAMES, OTHER_RETURNS, summed_by_unit, too_short
from gridtrack.evaluation.statistics.uncertainty import LEAST_UNITS, ratio_differences, ratio_interval


class ClassInference:
    """A run's class probabilities under the rules of all its scores: the same units, differences on common frames."""

    def __init__(self, recordings: Mapping[str, RecordingDescription], inference: Inference) -> None:
        self._recordings = recordings
        self._inference = inference
        self._losses: dict[str, FrameCounts] = {}

    def scores(self, trials: Sequence[FinishedTrial], names: Sequence[str]) -> ScoresByClass:
        """Scores by class of `trials` together, with intervals; `names` are the recordings that they are scores of.

        There are none where the recordings differ in their classes. Raises ScoresError.
        """
        described = self._recordings[names[0]]
        classes = described.classes if self._alike(names) else ()
        scores = class_scores([(t.record, t.folder) for t in trials], classes, described.horizons_s)
        if scores.semantics is None:
            return scores
        scored = [trial for trial in trials if trial.record.frames_scored]
        return ScoresByClass(scores.recall_by_class, self._with_intervals(scores.semantics, scored))

    def differences(self) -> list[ClassDifference]:
        """Log loss of each tracker's classes less the reference's: over all recordings if pooled, else on each.

        Of the trackers that give classes on every one of them; none where the reference does not.
        """
        found = []
        for names in self._inference.groups:
            rows = {
                label: trials
                for label in self._inference.labels
                if len(trials := [t for t in self._inference.complete(label, names) if _gives_classes(t)]) == len(names)
            }
            reference = self._reference(rows)
            if reference is not None and self._alike(names):
                found += [self._difference(rows[label], rows[reference], names) for label in rows if label != reference]
        return found

    def _reference(self, rows: Mapping[str, Sequence[FinishedTrial]]) -> str | None:
        """The run's reference where it gives classes, else the first row that is one for classes, else the first."""
        described = [label for label, trials in rows.items() if "classes" in trials[0].record.reference_for]
        requested = [label for label in rows if label == self._inference.reference]
        return next(iter([*requested, *described, *rows]), None)

    def _with_intervals(self, semantics: SemanticScores, trials: Sequence[FinishedTrial]) -> SemanticScores:
        """`semantics` with the intervals of the log loss of scans; where there are none, `interval` has the reason."""
        names = [trial.record.recording for trial in trials]
        block_s = self._inference.block_s(names)
        (losses,), units = summed_by_unit([[self._losses_of(trial) for trial in trials]], block_s)
        if units < LEAST_UNITS:
            why = too_short(units, len(names), block_s)
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
        pairs = [common_frames(*map(self._losses_of, pair)) for pair in zip(own, others, strict=True)]
        difference = ClassDifference(
            recordings=ALL_RECORDINGS if len(names) > 1 else names[0],
            tracker=own[0].record.label,
            reference=others[0].record.label,
            frames=sum(len(one.stamps_ns) for one, _ in pairs),
        )
        if not difference.frames:
            why = OTHER_FRAMES if own[0].points == others[0].points else OTHER_RETURNS
            return difference.model_copy(update={"interval": why})
        block_s = self._inference.block_s(names)
        sides, units = summed_by_unit([[pair[side] for pair in pairs] for side in (0, 1)], block_s)
        mine, theirs = ((losses[..., 0], losses[..., 1]) for losses in sides)
        found = ratio_differences(mine, theirs)
        kinds = {
            visibility: ClassLossCurves(
                nll_per_scan=rounded_curve(found.value[:, i]),
                nll_per_scan_low=rounded_curve(found.low[:, i]),
                nll_per_scan_high=rounded_curve(found.high[:, i]),
                nll_per_scan_p=rounded_p_curve(found.p[:, i]),
            )
            for i, visibility in enumerate(VISIBILITIES)
        }
        why = too_short(units, len(names), block_s) if units < LEAST_UNITS else ""
        return difference.model_copy(update={"units": units, "interval": why, "kinds": kinds})

    def _losses_of(self, trial: FinishedTrial) -> FrameCounts:
        """Per scored frame, step and visibility the mean loss over the scan's cells, and 1 for a scan with any."""
        key = trial.folder.name
        if key not in self._losses:
            frames = self._inference.frames_of(trial)
            losses = read_scan_losses(trial.folder, frames.stamps_ns, trial.record.steps)
            self._losses[key] = FrameCounts(frames.stamps_ns, frames.delivered, losses)
        return self._losses[key]

    def _alike(self, names: Sequence[str]) -> bool:
        classes = [self._recordings[name].classes for name in names]
        return bool(classes[0]) and all(one == other for one, other in pairwise(classes))


def _gives_classes(trial: FinishedTrial) -> bool:
    return (trial.folder / SEMANTICS_TABLE.file).exists()
