"""Leaks: frames that a tracker is scored on, or its thresholds are chosen on, and that its weights learned from."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import chain

from gridtrack.common.errors import ConfigurationError
from gridtrack.evaluation.runs.learned import LearnedWeights
from gridtrack.evaluation.scoring.splits import EvaluationSplit, common_with
from gridtrack.recordings.recorded_time import RecordedTime
from gridtrack.recordings.stream import GridStream
from gridtrack.trackers.card import TrainingData


def leaks_of(split: EvaluationSplit, weights: LearnedWeights | None) -> tuple[str, ...]:
    """What `weights` learned from the frames of `split`, a line for each part that they have in common."""
    return tuple(dict.fromkeys(_leaks(split, weights))) if weights else ()


def refuse_leaks(leaks: Iterable[tuple[str, ...]]) -> None:
    """Raise ConfigurationError where any trial of a comparison has leaks; the argument has those of each trial."""
    found = list(dict.fromkeys(chain.from_iterable(leaks)))
    if found:
        more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
        raise ConfigurationError(
            f"{found[0]}{more}: compare on other frames, or with --allow-leak, which marks such rows and does not"
            " rank them"
        )


def _leaks(split: EvaluationSplit, weights: LearnedWeights) -> Iterator[str]:
    card = weights.card
    for seen, use in ((card.train, "was trained on"), (card.validation, "was selected on")):
        yield from _common(weights, split.test, seen, f"{use} frames of the test stretch")
    if split.validation:
        yield from _common(
            weights, split.validation, card.train, "was trained on frames of the stretch that thresholds are chosen on"
        )


def _common(weights: LearnedWeights, stretch: GridStream, seen: Iterable[TrainingData], what: str) -> Iterator[str]:
    """A line for each training data that has frames of the `stretch`."""
    for data in seen:
        common = common_with(stretch, data)
        if common is not None:
            yield f"{weights.name} {what} {stretch.name}, {_in_recording(stretch, common)}, as {data.recording}"


def _in_recording(stretch: GridStream, time: RecordedTime) -> str:
    """A time in seconds of the recording of `stretch`, and its stamps."""
    first_ns = stretch.recording.survey.first_ns
    start_s, end_s = ((at_ns - first_ns) / 1e9 for at_ns in (time.start_ns, time.end_ns))
    return f"{start_s:g} s to {end_s:g} s (stamps {time.start_ns} to {time.end_ns})"
