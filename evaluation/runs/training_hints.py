"""Advice on training: stretches to train and to validate on that share no frame with the scored ones."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from gridtrack.common.errors import RecordingError
from gridtrack.evaluation.referee.referee import WARM_UP
from gridtrack.evaluation.referee.splits import TRAIN, VALIDATION, EvaluationSplit, like, shares_frames
from gridtrack.recordings.recording_info import Stretch, stretch_text
from gridtrack.recordings.stream import GridStream

TRAIN_SHARE = 0.6
"""Share of a stretch to train on; the rest is for validation."""
TRAIN_PART, VALIDATION_PART = 0.6, 0.8
"""Ends of the parts for training and for validation, if the rest of a recording is compared on."""


@dataclass(frozen=True, slots=True)
class TrainingStretches:
    """Arguments of `gridtrack train`: `recording` and `validation` as RECORDING[@range], "" for the recording's own.

    `compare` is the rest to compare on, "" if the compared stretch can stay.
    """

    recording: str
    validation: str = ""
    compare: str = ""

    @property
    def arguments(self) -> tuple[str, ...]:
        """The words of the command line."""
        return (self.recording, *(("--validation", self.validation) if self.validation else ()))


def stretches_to_train_on(split: EvaluationSplit, others: Sequence[EvaluationSplit] = ()) -> TrainingStretches | None:
    """The stretches to train on for a comparison on `split` and `others`; None if its recording is too short.

    The recording's own stretches, or the longest part without frames of the comparison, or three parts of it all.
    """
    test, path, compared = split.test, str(split.path), (split, *others)
    if _has_own(test, compared):
        return TrainingStretches(path)
    shortest_s = (WARM_UP + split.steps + 1) * test.period_s
    free = max(_free(test, compared), key=lambda part: part[1] - part[0], default=(0.0, 0.0))
    if (free[1] - free[0]) * (1.0 - TRAIN_SHARE) > shortest_s:
        recording, validation = _in_two(path, *free)
        return TrainingStretches(recording, validation)
    duration_s = test.recording.survey.duration_s
    if duration_s * (1.0 - VALIDATION_PART) < shortest_s:
        return None
    train_end_s, validation_end_s = (_tenths(duration_s * part) for part in (TRAIN_PART, VALIDATION_PART))
    return TrainingStretches(
        _named(path, (0.0, train_end_s)),
        _named(path, (train_end_s, validation_end_s)),
        _named(path, (validation_end_s, None)),
    )


def _has_own(test: GridStream, compared: Sequence[EvaluationSplit]) -> bool:
    """Whether the recording names stretches to train and to validate on, without frames that are scored.

    Thresholds may be chosen on the stretch to validate on.
    """
    if not {TRAIN, VALIDATION} <= test.recording.info.stretches.keys():
        return False
    try:
        train, validation = like(test, TRAIN), like(test, VALIDATION)
    except RecordingError:  # they lie beyond the end of a recording that is cut off
        return False
    tests = (split.test for split in compared)
    return not (
        any(shares_frames(train, stretch) for stretch in _scored(compared))
        or any(shares_frames(validation, stretch) for stretch in tests)
    )


def in_two(stream: GridStream) -> TrainingStretches:
    """The stretch of `stream` cut in two, to train and to validate on."""
    start_s, end_s = stream.stretch_s
    end_s = stream.recording.survey.duration_s if end_s is None else end_s
    return TrainingStretches(*_in_two(str(stream.recording.path), start_s, end_s))


def _in_two(path: str, start_s: float, end_s: float) -> tuple[str, str]:
    cut_s = _tenths(start_s + TRAIN_SHARE * (end_s - start_s))
    return _named(path, (start_s, cut_s)), _named(path, (cut_s, end_s))


def _scored(compared: Iterable[EvaluationSplit]) -> Iterator[GridStream]:
    """The stretches that weights must not have learned from."""
    for split in compared:
        yield split.test
        if split.validation is not None:
            yield split.validation


def _free(test: GridStream, compared: Iterable[EvaluationSplit]) -> Iterator[tuple[float, float]]:
    """The parts of the recording of `test` without scored frames, seconds, in tenths."""
    survey, whole = test.recording.survey, like(test)
    taken = sorted(
        tuple((at_ns - survey.first_ns) / 1e9 for at_ns in (stretch.recorded.start_ns, stretch.recorded.end_ns))
        for stretch in _scored(compared)
        if shares_frames(stretch, whole)
    )
    free_from_s = 0.0
    for start_s, end_s in (*taken, (survey.duration_s, survey.duration_s)):
        if start_s > free_from_s:
            yield free_from_s, _tenths(start_s)
        free_from_s = max(free_from_s, math.ceil(end_s * 10) / 10)


def _tenths(time_s: float) -> float:
    return math.floor(time_s * 10) / 10


def _named(path: str, stretch: Stretch) -> str:
    return f"{path}@{stretch_text(stretch)}"
