"""Segments: a long test stretch as several parts, each a trial of its own, that score what the whole would."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

from gridtrack.evaluation.scoring.referee import WARM_UP
from gridtrack.evaluation.scoring.splits import EvaluationSplit, like
from gridtrack.recordings.recording_info import stretch_text


def segments_of(split: EvaluationSplit, segment_s: float, warm_up_s: float) -> Iterator[EvaluationSplit]:
    """`split` as equal segments of at most `segment_s`; itself where it is not longer.

    Together they are scored at the frames at which the whole is. Each begins `warm_up_s` before its first scored
    forecast, but not before the test stretch, and ends with the horizon of its last one.
    """
    scored = split.schedule.scored
    per_segment = max(1, int(segment_s / (split.every * split.test.period_s) + 1e-9))
    segments = math.ceil(len(scored) / per_segment)
    if segments == 1:
        yield split
        return
    warm_up = max(WARM_UP, round(warm_up_s / split.test.period_s))
    for number in range(segments):
        yield _segment(split, scored[_share(len(scored), number, segments)], warm_up)


def _share(count: int, number: int, segments: int) -> slice:
    """The part `number` of `count` frames in equal parts."""
    return slice(count * number // segments, count * (number + 1) // segments)


def _segment(split: EvaluationSplit, scored: range, warm_up: int) -> EvaluationSplit:
    """The segment that is scored at the frames `scored` of the whole test stretch."""
    period_s, start_s = split.test.period_s, split.test.start_s
    first, stop = max(0, scored[0] - warm_up), scored[-1] + split.steps + 1
    to_s = min(start_s + stop * period_s, split.test.recording.survey.duration_s)
    named = round(start_s + scored[0] * period_s, 3), round(start_s + scored.stop * period_s, 3)
    return replace(
        split,
        name=f"{split.path.stem}@{stretch_text(named)}",
        test=like(split.test, (start_s + first * period_s, to_s), split.test.points),
        warm_up=scored[0] - first,
        segment_of=split.name,
    )
