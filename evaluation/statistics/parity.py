"""Whether the trackers of a run received the same frames: only then do their scores compare."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from gridtrack.evaluation.statistics.finished_trial import FinishedTrial
from gridtrack.evaluation.statistics.trial_files import TrialFiles


def mismatched_deliveries(trials: Sequence[FinishedTrial], files: TrialFiles) -> list[str]:
    """Labels of the trials of one recording that were delivered other frames than most at a stamp they share.

    Trials of raw returns are compared among themselves: their frames differ by design. Raises ScoresError.
    """
    usual: dict[tuple[str, int], Counter[str]] = {}
    scored = [trial for trial in trials if trial.record.frames_scored]
    frames = [(trial, files.frames(trial)) for trial in scored]
    deliveries = [(trial, dict(zip(of.stamps_ns.tolist(), of.delivered.tolist(), strict=True))) for trial, of in frames]
    for trial, delivered in deliveries:
        for stamp, digest in delivered.items():
            usual.setdefault((trial.points, stamp), Counter())[digest] += 1
    return [
        trial.record.label
        for trial, delivered in deliveries
        if any(digest != usual[trial.points, stamp].most_common(1)[0][0] for stamp, digest in delivered.items())
    ]
