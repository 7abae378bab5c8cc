"""What a run's summary says of classes: scores, the intervals of the log loss, and each tracker against a reference."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

from gridtrack.evaluation.scoring.class_scores import class_scores
from gridtrack.evaluation.scoring.class_store import SEMANTICS, read_scan_losses
from gridtrack.evaluation.scoring.semantics import VISIBILITIES
from gridtrack.evaluation.statistics.curves import curve
from gridtrack.evaluation.statistics.frame_counts import FrameCounts, common_frames
from gridtrack.evaluation.statistics.inference import ALL_RECORDINGS, Ended, Inference, plain_curve
from gridtrack.evaluation.statistics.pooling import OTHER_FRAMES, OTHER_RETURNS, summed_by_unit, too_short
from gridtrack.evaluation.statistics.uncertainty import LEAST_UNITS, ratio_differences, ratio_interval

SCORE = "nll_per_scan"
USUAL_REFERENCE = "one-shot"
"""The tracker that the others' classes are set against, if it ran: it knows one scan and no more."""


class ClassInference:
    """A run's classes under the rules of all its scores: the same units, and differences on frames in common."""

    def __init__(
        self, recordings: Mapping[str, Mapping[str, Any]], trials: Sequence[Ended], inference: Inference
    ) -> None:
        """`recordings` as the summary describes them, `trials` of them all."""
        self._recordings = recordings
        self._trials = trials
        self._inference = inference
        self._losses: dict[str, FrameCounts] = {}

    def add_scores(self, trackers: Mapping[str, Any]) -> None:
        """Add what was scored by class to every trial, and pooled where all recordings have the same classes."""
        for label, entry in trackers.items():
            own = [trial for trial in self._trials if trial.record.label == label]
            for trial in own:
                entry["recordings"][trial.record.recording] |= self._scores([trial], [trial.record.recording])
            if entry["pooled"]:
                entry["pooled"] |= self._scores([trial for trial in own if trial.complete], list(self._recordings))

    def differences(self) -> list[dict[str, Any]]:
        """Log loss of each tracker's classes less the reference's: over all recordings if pooled, else on each.

        Only of trackers that give classes on every one of them, and none where the reference does not.
        """
        found = []
        for names in self._inference.groups:
            rows = {
                label: trials
                for label in self._inference.labels
                if len(trials := [t for t in self._inference.complete(label, names) if _names_classes(t)]) == len(names)
            }
            reference = self._reference(rows)
            if reference is not None and self._alike(names):
                found += [self._difference(rows[label], rows[reference], names) for label in rows if label != reference]
        return found

    def _reference(self, rows: Mapping[str, Sequence[Ended]]) -> str | None:
        """The run's reference where it gives classes, else the first row of the usual one, else the first."""
        usual = [label for label, trials in rows.items() if trials[0].tracker == USUAL_REFERENCE]
        asked = [label for label in rows if label == self._inference.reference]
        return next(iter([*asked, *usual, *rows]), None)

    def _scores(self, trials: Sequence[Ended], names: Sequence[str]) -> dict[str, Any]:
        """As of `class_scores`, with intervals."""
        described = self._recordings[names[0]]
        classes = described.get("classes", ()) if self._alike(names) else ()
        scores = class_scores([(t.record, t.folder) for t in trials], classes, described["horizons_s"])
        if scores["semantics"]:
            scored = [trial for trial in trials if trial.record.frames_scored]
            found = self._intervals(scored, [trial.record.recording for trial in scored])
            for kind in scores["semantics"]["kinds"]:
                scores["semantics"]["kinds"][kind] |= found[kind]
        return scores

    def _intervals(self, trials: Sequence[Ended], names: Sequence[str]) -> dict[str, dict[str, Any]]:
        """By kind the ends of SCORE's interval at every step; where there is none, `interval` says why."""
        block_s = self._inference.block_s(names)
        (losses,), units = summed_by_unit([[self._losses_of(trial) for trial in trials]], block_s)
        if units < LEAST_UNITS:
            why = too_short(units, len(names), block_s)
            return {kind: {f"{SCORE}_low": None, f"{SCORE}_high": None, "interval": why} for kind in VISIBILITIES}
        low, high = ratio_interval(losses[..., 0], losses[..., 1])
        return {
            kind: {f"{SCORE}_low": curve(low[:, i]), f"{SCORE}_high": curve(high[:, i]), "interval": ""}
            for i, kind in enumerate(VISIBILITIES)
        }

    def _difference(self, own: Sequence[Ended], others: Sequence[Ended], names: Sequence[str]) -> dict[str, Any]:
        pairs = [common_frames(*map(self._losses_of, pair)) for pair in zip(own, others, strict=True)]
        said = {
            "recordings": ALL_RECORDINGS if len(names) > 1 else names[0],
            "tracker": own[0].record.label,
            "reference": others[0].record.label,
            "frames": sum(len(one.stamps_ns) for one, _ in pairs),
        }
        if not said["frames"]:
            why = OTHER_FRAMES if own[0].points == others[0].points else OTHER_RETURNS
            return {**said, "units": 0, "interval": why, "kinds": {}}
        block_s = self._inference.block_s(names)
        sides, units = summed_by_unit([[pair[side] for pair in pairs] for side in (0, 1)], block_s)
        mine, theirs = ((losses[..., 0], losses[..., 1]) for losses in sides)
        found = ratio_differences(mine, theirs)
        ends = {SCORE: found.value, f"{SCORE}_low": found.low, f"{SCORE}_high": found.high, f"{SCORE}_p": found.p}
        kinds = {
            kind: {key: plain_curve(key, values[:, i]) for key, values in ends.items()}
            for i, kind in enumerate(VISIBILITIES)
        }
        why = too_short(units, len(names), block_s) if units < LEAST_UNITS else ""
        return {**said, "units": units, "interval": why, "kinds": kinds}

    def _losses_of(self, trial: Ended) -> FrameCounts:
        """Per scored frame, step and kind the mean loss over the scan's cells, and 1 for a scan with any."""
        key = trial.folder.name
        if key not in self._losses:
            frames = self._inference.frames_of(trial)
            losses = read_scan_losses(trial.folder, frames.stamps_ns, trial.record.steps)
            self._losses[key] = FrameCounts(frames.stamps_ns, frames.delivered, losses)
        return self._losses[key]

    def _alike(self, names: Sequence[str]) -> bool:
        classes = [tuple(self._recordings[name].get("classes", ())) for name in names]
        return bool(classes[0]) and all(one == other for one, other in pairwise(classes))


def _names_classes(trial: Ended) -> bool:
    return (trial.folder / SEMANTICS).exists()
