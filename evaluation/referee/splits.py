"""Evaluation splits: the test and validation stretches of a recording, its steps, strata and schedule."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

from gridtrack.common.errors import ConfigurationError, NothingMeasuredError, RecordingError
from gridtrack.common.files import NAME_RULE, is_name, name_from
from gridtrack.common.grid import GridSpec, Points, nearest_step
from gridtrack.common.notices import Notice
from gridtrack.evaluation.referee.kinds import Regions, regions_of
from gridtrack.evaluation.referee.referee import WARM_UP, KeptMoments, Schedule
from gridtrack.evaluation.referee.strata import STRATA, STRATA_WITH_TRUTH
from gridtrack.recordings import Recording, Stretch, open_recording
from gridtrack.recordings.recording_info import NO_MOTION, RecordingInfo, stretch_text
from gridtrack.recordings.stream import GridStream
from gridtrack.recordings.stretches import RecordedTime, parse_stretch
from gridtrack.trackers.training.card import TrainingData

ORACLE = "oracle"
"""Label of the ceiling, which the referee computes if there is truth; no tracker may have it."""
TEST, VALIDATION, TRAIN = "test", "validation", "train"
"""Names of stretches in a recording that have a use here."""
_CARDS = "thresholds from the cards of the weights, 0.5 without one: no usable validation stretch (--validation)"
_OF_CARD = (
    ", so the thresholds of a tracker come from its weights' card (chosen on the validation stretches of its"
    " training), and 0.5 if there is none; name a stretch with --validation"
)
USUAL_EVERY_S, LEAST_FORECASTS = 1.0, 30
"""Time between scored forecasts by default, and the least number of forecasts for which it is shortened."""
MAX_FORECAST_BYTES = 1 << 30
VALIDATION_FORECASTS = 60
"""Approximate minimum of forecasts on which thresholds are chosen; with ten or twenty the choice is noise."""


@dataclass(frozen=True, slots=True)
class Sampling:
    """Grid and rate of the streams (None: the recording's own), horizon and period of the forecasts."""

    horizon_s: float
    every_s: float | None
    """None: USUAL_EVERY_S, or less so that a short stretch has LEAST_FORECASTS."""
    grid: GridSpec | None = None
    rate_hz: float | None = None
    format: str | None = None
    """The recording format of another package, as of `ReadOptions`."""


@dataclass(frozen=True, slots=True)
class SplitRegions:
    """Regions of the test and of the validation stretch: the same if both are of one recording."""

    test: Regions
    validation: Regions


@dataclass(frozen=True, slots=True)
class SplitMoments:
    """Moments of the test and of the validation stretch, for the trials with the same `points`."""

    test: KeptMoments
    validation: KeptMoments | None


@dataclass(frozen=True, slots=True)
class EvaluationSplit:
    """One recording of a comparison with its stretches, steps and forecast period in frames.

    `name` is unique in a run and identifies the split in every file. `warm_up` frames at the start of the test stretch
    are delivered and not scored. `segment_of` is the name of the whole, where it is a segment of one.
    """

    name: str
    path: Path
    test: GridStream
    validation: GridStream | None
    steps: int
    every: int
    notices: tuple[Notice, ...] = ()
    warm_up: int = WARM_UP
    segment_of: str | None = None

    @property
    def whole(self) -> str:
        """The name of the whole split of a segment, else its own: regions belong to the whole."""
        return self.segment_of or self.name

    @property
    def schedule(self) -> Schedule:
        """The frames of the test stretch that are forecast from."""
        return Schedule(len(self.test), self.steps, self.every, self.warm_up)

    @property
    def strata(self) -> tuple[str, ...]:
        """Names of the strata that are scored."""
        return STRATA_WITH_TRUTH if self.test.has_truth else STRATA

    @property
    def oracle_name(self) -> str:
        """The name of the oracle's folder."""
        return f"{ORACLE}@{self.name}"

    @property
    def validation_schedule(self) -> Schedule:
        """The frames of the validation stretch that are forecast from: as often as in the test, more often if short."""
        assert self.validation is not None
        frames = len(self.validation)
        enough = -(-(frames - WARM_UP - self.steps) // VALIDATION_FORECASTS)
        return Schedule(frames, self.steps, min(self.every, enough))

    def regions(self, check: Callable[[], None] = lambda: None) -> SplitRegions:
        """Regions of both stretches, each as of `regions_of`; a single pass if both are of one recording."""
        test = regions_of(self.test, self.strata, check)
        if self.validation is None or self.validation.sha256 == self.test.sha256:
            return SplitRegions(test, test)
        return SplitRegions(test, regions_of(self.validation, self.strata, check))

    def moments(self, regions: SplitRegions, points: Points = "centres") -> SplitMoments:
        """The moments of both stretches, with these `regions` and the returns `points`."""
        test = KeptMoments(with_points(self.test, points), regions.test)
        if self.validation is None:
            return SplitMoments(test, None)
        return SplitMoments(test, KeptMoments(with_points(self.validation, points), regions.validation))


def plan_splits(texts: Iterable[str], validation: str | None, sampling: Sampling) -> tuple[EvaluationSplit, ...]:
    """The split of each RECORDING[@range]; without a range the stretch named `test`, else the whole recording.

    Thresholds are chosen on `validation`, RECORDING[@range], else on the recording's own validation stretch. Each
    recording is read once for all its stretches. Raises RecordingError, and ConfigurationError where the horizon or the
    stretches do not fit.
    """
    opened = cache(partial(open_recording, format=sampling.format))
    chosen_on = opened(parse_stretch(validation)[0]) if validation else None
    return tuple(_plan_split(text, opened(parse_stretch(text)[0]), validation, sampling, chosen_on) for text in texts)


def plan_split(text: str, validation: str | None, sampling: Sampling) -> EvaluationSplit:
    """The split of one RECORDING[@range], as of `plan_splits`."""
    (split,) = plan_splits((text,), validation, sampling)
    return split


def _plan_split(
    text: str, recording: Recording, validation: str | None, sampling: Sampling, opened: Recording | None
) -> EvaluationSplit:
    """`plan_split` of an open recording; `opened` is the recording of `validation`."""
    path, stretch = parse_stretch(text)
    if stretch is None and TEST in recording.info.stretches:
        return split_of(recording, name_from(path), TEST, validation, sampling, opened)
    name = name_from(path) if stretch is None else f"{name_from(path)}@{text.rpartition('@')[2]}"
    return split_of(recording, name, stretch, validation, sampling, opened)


def split_of(
    recording: Recording,
    name: str,
    stretch: Stretch | str | None,
    validation: str | None,
    sampling: Sampling,
    opened: Recording | None = None,
) -> EvaluationSplit:
    """The split called `name` of a stretch of `recording` (None: all of it); the others as of `plan_split`."""
    path = recording.path
    if not is_name(name):
        raise ConfigurationError(f"{path}: '{name}' cannot be the name of a folder of results: {NAME_RULE}; rename it")
    refuse_unmeasured(recording)
    test = GridStream(recording, stretch, grid=sampling.grid, rate_hz=sampling.rate_hz)
    steps = _steps(test, sampling.horizon_s)
    every, often = _every(test, steps, sampling.every_s)
    if not Schedule(len(test), steps, every).expected:
        raise ConfigurationError(f"{_too_short(test, steps)}: name a longer stretch, or a shorter --horizon")
    if validation is not None and opened is None:
        opened = open_recording(parse_stretch(validation)[0], format=sampling.format)
    chosen_on, of_thresholds = _validation_stretch(test, validation, steps, opened)
    notices = [*recording.notices, *of_thresholds, *often, *_unrecorded_poses(recording.info)]
    if chosen_on and chosen_on.recording is not recording:
        of_validation = chosen_on.recording.notices
        notices += [
            one.model_copy(update={"text": f"validation {chosen_on.name}: {one.text}"}) for one in of_validation
        ]
    named = (one.model_copy(update={"recording": name}) for one in notices)
    return EvaluationSplit(name, path, test, chosen_on, steps, every, tuple(dict.fromkeys(named)))


def _unrecorded_poses(info: RecordingInfo) -> Iterator[Notice]:
    """A notice of poses that are assumed or matched; recorded ones are as usual."""
    kind = NO_MOTION if info.assumes_rest else "from matching the scans" if info.has_matched_poses else ""
    if kind:
        yield Notice(text=f"poses: {info.poses}", kind=f"poses: {kind}")


def _every(test: GridStream, steps: int, every_s: float | None) -> tuple[int, tuple[Notice, ...]]:
    """The frames from one scored forecast to the next, and a notice if the stretch is short for the default."""
    if every_s is not None:
        return max(1, round(every_s / test.period_s)), ()
    usual = max(1, round(USUAL_EVERY_S / test.period_s))
    every = max(1, min(usual, (len(test) - WARM_UP - steps) // LEAST_FORECASTS))
    if every == usual:
        return every, ()
    forecasts = Schedule(len(test), steps, every).expected
    period_s = float(f"{every * test.period_s:.3g}")
    kind = "{} forecasts, one every {} s (--every)"
    text = f"{forecasts} forecasts, one every {period_s:g} s (--every)"
    return every, (Notice(text=text, kind=kind, values=(forecasts, period_s)),)


def refuse_unmeasured(recording: Recording) -> None:
    """Raise NothingMeasuredError for a recording without a measured range; one that is still written may get some."""
    if recording.growth is None and (why := recording.survey.nothing_measured):
        raise NothingMeasuredError(f"{recording.path}: {why}")


def _steps(stream: GridStream, horizon_s: float) -> int:
    """The horizon in steps. Raises ConfigurationError for less than one step, and for forecasts that are too large."""
    steps = nearest_step(horizon_s, stream.period_s)
    if steps < 1:
        raise ConfigurationError(
            f"a horizon of {horizon_s:g} s is less than half a frame of {stream.name} ({stream.period_s:g} s): give a"
            " longer one with --horizon"
        )
    size = (steps + 1) * stream.grid.size**2 * 4
    if size > MAX_FORECAST_BYTES:
        raise ConfigurationError(
            f"forecasts of {steps} steps on {stream.grid.size} x {stream.grid.size} cells take {size} bytes each,"
            f" more than the limit of {MAX_FORECAST_BYTES}: choose a shorter --horizon, lower --rate or smaller --grid"
        )
    return steps


def _too_short(stream: GridStream, steps: int) -> str:
    return (
        f"{stream.name}: {len(stream)} frames leave nothing to score after {WARM_UP} frames of warm-up and with {steps}"
        " steps ahead"
    )


def _validation_stretch(
    test: GridStream, requested: str | None, steps: int, opened: Recording | None
) -> tuple[GridStream | None, tuple[Notice, ...]]:
    """The stretch on which thresholds are chosen, or None with notices; it shares no frame with the test stretch.

    A stretch that cannot be used is an error where it was requested, and a notice where the recording names it.
    """
    if requested is not None:
        assert opened is not None  # with `requested`
        stretch = GridStream(opened, parse_stretch(requested)[1], grid=test.grid, rate_hz=1e9 / test.period_ns)
    elif VALIDATION in test.recording.info.stretches and test.recording.growth is None:
        stretch = own_validation(test)
    else:
        return None, (Notice(text=f"no validation stretch{_OF_CARD}", kind=_CARDS),)
    problem = ""
    if shares_frames(test, stretch):
        problem = f"{test.name} shares frames with its validation {stretch.name}"
    elif len(stretch) <= WARM_UP + steps:
        problem = _too_short(stretch, steps)
    if problem and requested is not None:
        raise ConfigurationError(f"{problem}: name another --validation")
    return (None, (Notice(text=problem + _OF_CARD, kind=_CARDS),)) if problem else (stretch, ())


def own_validation(stream: GridStream) -> GridStream:
    """The stretch named `validation` of the recording. Raises RecordingError if there is none."""
    try:
        return like(stream, VALIDATION)
    except RecordingError as error:
        raise RecordingError(f"{error} with --validation RECORDING@range") from None


def like(stream: GridStream, stretch: Stretch | str | None = None, points: Points | None = None) -> GridStream:
    """Another stretch of the same recording, on the same grid and period; None: the whole recording."""
    return GridStream(
        stream.recording,
        stretch,
        grid=stream.grid,
        rate_hz=1e9 / stream.period_ns,
        points=points or stream.points,
    )


def with_points(stream: GridStream, points: Points) -> GridStream:
    """The same stretch with the returns `points`."""
    return stream if points == stream.points else like(stream, stream.stretch_s, points)


def shares_frames(one: GridStream, other: GridStream) -> bool:
    """Whether two stretches hold a moment in common, under whatever name or cut their recordings come."""
    return one.recorded.overlaps(other.recorded)


def common_with(test: GridStream, seen: TrainingData) -> RecordedTime | None:
    """The part of the stretch `test` that is in the training data `seen`, or None.

    Data of a card that does not say their site count as of the site of `test`.
    """
    if seen.source_sha256:
        site = seen.site or test.site
        return test.recorded.common(RecordedTime(seen.source_sha256, site, seen.start_ns, seen.end_ns))
    return _common_by_name(test, seen)


def _common_by_name(test: GridStream, seen: TrainingData) -> RecordedTime | None:
    """`common_with` of a card without stamps; a stretch that the recording no longer names is the whole of it."""
    if seen.sha256 not in (test.sha256, test.recorded.source_sha256):
        return None
    _, stretch = parse_stretch(seen.recording)
    if isinstance(stretch, str):
        stretch = test.recording.info.stretches.get(stretch)
    start_s, end_s = stretch or (0.0, None)
    survey = test.recording.survey
    end_ns = survey.last_ns + test.period_ns if end_s is None else survey.first_ns + round(end_s * 1e9)
    return test.recorded.common(replace(test.recorded, start_ns=survey.first_ns + round(start_s * 1e9), end_ns=end_ns))


def segments_of(split: EvaluationSplit, segment_s: float, warm_up_s: float) -> Iterator[EvaluationSplit]:
    """`split` as equal segments of at most `segment_s`; itself if it is not longer.

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
        name=f"{name_from(split.path)}@{stretch_text(named)}",
        test=like(split.test, (start_s + first * period_s, to_s), split.test.points),
        warm_up=scored[0] - first,
        segment_of=split.name,
    )
