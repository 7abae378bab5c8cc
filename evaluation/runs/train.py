"""Training of a tracker by a recipe, for a site or for any place: `gridtrack train`."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.cache import FileCache
from gridtrack.common.errors import ConfigurationError, WeightsError
from gridtrack.common.files import sha256_of
from gridtrack.common.grid import GridSpec, nearest_step
from gridtrack.common.remote_files import is_url
from gridtrack.evaluation.hosting.limits import Limits
from gridtrack.evaluation.referee.kinds import CellKinds, Regions
from gridtrack.evaluation.referee.referee import WARM_UP, Delivery, moments
from gridtrack.evaluation.referee.splits import (
    TEST,
    TRAIN,
    VALIDATION,
    EvaluationSplit,
    common_with,
    own_validation,
    refuse_unmeasured,
    shares_frames,
)
from gridtrack.evaluation.referee.strata import STRATA, STRATA_WITH_TRUTH
from gridtrack.evaluation.runs.learned import (
    LearnedWeights,
    copy_weights,
    find_weights,
    user_weights_folder,
    weights_path,
)
from gridtrack.evaluation.runs.plan import Trial
from gridtrack.evaluation.runs.recipe import Recipe, with_local_copies
from gridtrack.evaluation.runs.stretch_files import StretchFiles, stretch_cache, surveyed
from gridtrack.evaluation.runs.training_hints import in_two
from gridtrack.evaluation.runs.training_process import ProgressLines, TrainingProcess
from gridtrack.evaluation.runs.trial import validation_tally
from gridtrack.evaluation.scores.cells import HALF, Tally
from gridtrack.evaluation.scores.thresholds import Thresholds, best_thresholds
from gridtrack.recordings import Recording, open_recording, recordings_at
from gridtrack.recordings.importing import posed_copy
from gridtrack.recordings.recording_info import Stretch, stretch_text
from gridtrack.recordings.stream import GridStream
from gridtrack.recordings.stretches import parse_stretch
from gridtrack.trackers.selection import Selection, launch
from gridtrack.trackers.training.card import GENERAL, CardThresholds, StartedFrom, TrainingData
from gridtrack.trackers.training.progress import Progress
from gridtrack.trackers.training.weights import add_thresholds, can_continue, complete_card, delete_progress, read_card

NamedStretch = tuple[Path, Stretch | str | None]
"""A recording, with a stretch, the name of a stretch, or None for its own."""
NAMED_STRETCHES = 3
"""Limit of the validation stretches that are named in a line."""
COMMAND = "the command of the training"
"""`fit` receives this instead of the command, which names files of recordings; the card gets the command afterwards."""


def train_tracker(recipe: Recipe, report: Callable[[str], None] = print) -> Path:
    """Fit the recipe's tracker to the recordings and return the card it wrote, `<out>/<tracker>/<site>.toml`.

    A general training writes `general.toml`; it starts from general weights if the recipe names some. A training at a
    site starts from general weights if there are some and the tracker supports it.

    Without ranges the recordings' own stretches `train` and `validation` are used. `fit` runs in its own process, which
    receives the frames of these stretches and nothing else of the recordings. Logs and checkpoints are written beside
    the card to `<site>.logs`; a second call resumes there. Raises GridtrackError, and KeyboardInterrupt with a line
    that says what is kept.
    """
    cache, local = stretch_cache(report), with_local_copies(recipe, report)
    uses = ((TRAIN, local.recordings), (VALIDATION, local.validation))
    named = {use: _named(texts, local, report) for use, texts in uses}
    with (
        TrainingProcess(recipe.tracker, [path for found in named.values() for path, _ in found]) as process,
        TemporaryDirectory(prefix="gridtrack-train-") as folder,
    ):
        can_start = process.load(recipe.options, general=recipe.general)
        with ProgressLines(report) as lines:
            train_on, validate_on = _stretches(recipe, named, cache, lines.progress)
        for line in _of_test_stretches([*train_on, *validate_on]):
            report(line)
        start = general_start(local, validate_on, Path(folder), report, can_start=can_start)
        if can_start and start is None and not recipe.general:
            recipe = recipe.model_copy(update={"from_scratch": True})
        site = GENERAL if recipe.general else _site_of(train_on[0])
        path = weights_path(recipe.out or user_weights_folder(), recipe.tracker, site)
        _make_folder(path.parent)
        stretches = StretchFiles([*train_on, *validate_on], Path(folder), cache)
        report(f"validation: {', '.join(stream.name for stream in validate_on[:NAMED_STRETCHES])}{_more(validate_on)}")
        _fit(process, stretches, len(train_on), recipe, start, path, report)
        _add_thresholds(recipe, path, stretches, len(train_on), report)
        delete_progress(_log_folder(path))
    return path


def _fit(
    process: TrainingProcess,
    stretches: StretchFiles,
    train_count: int,
    recipe: Recipe,
    start: LearnedWeights | None,
    path: Path,
    report: Callable[[str], None],
) -> None:
    """Train on the first `train_count` of `stretches`, and complete the card at `path`, also after an interrupt.

    Raises KeyboardInterrupt with a line that says what is kept.
    """
    with ProgressLines(report) as lines:
        files = stretches.frames(lines.progress)
    interrupted = False
    try:
        process.fit(
            files[:train_count],
            files[train_count:],
            stretches.regions,
            report,
            out=path,
            log_dir=_log_folder(path),
            seed=recipe.seed,
            command=COMMAND,
            general=recipe.general,
            start=start.path if start else None,
        )
    except KeyboardInterrupt:
        interrupted = True
    finally:
        train_on, validate_on = stretches.streams[:train_count], stretches.streams[train_count:]
        written = path.exists() and _complete(path, recipe, train_on, validate_on, start)
    if interrupted:
        raise KeyboardInterrupt(_what_is_kept(path, written=written))


def _add_thresholds(
    recipe: Recipe, path: Path, stretches: StretchFiles, train_count: int, report: Callable[[str], None]
) -> None:
    """Choose the thresholds of the card at `path` on the stretches after the first `train_count`."""
    report("choosing the thresholds on the card, for recordings without a validation stretch")
    validation = range(train_count, len(stretches.streams))
    try:
        with ProgressLines(report) as lines:
            kinds = [(stretches.streams[n], stretches.kinds(n)) for n in validation]
            thresholds = choose_card_thresholds(_thresholds_row(recipe), path, kinds, lines.progress)
            if thresholds is not None:
                add_thresholds(path, thresholds)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"interrupted; {path} is complete, but without thresholds; the same command adds them"
        ) from None


def _thresholds_row(recipe: Recipe) -> Selection:
    """The tracker with the weights of the `recipe`, on the device of its options."""
    return Selection(recipe.tracker, recipe.tracker, {k: v for k, v in recipe.options.items() if k == "device"})


def _complete(
    path: Path,
    recipe: Recipe,
    train_on: Sequence[GridStream],
    validate_on: Sequence[GridStream],
    start: LearnedWeights | None,
) -> bool:
    """Add command, training data and start to the card that `fit` wrote. Returns False if it wrote none."""
    train, validation = _data_of(train_on), _data_of(validate_on)
    if start is None:
        return complete_card(path, COMMAND, recipe.command, train, validation)
    started_from = StartedFrom(name=start.name, sha256=start.sha256)
    train, validation = [*train, *start.card.train], [*validation, *start.card.validation]
    return complete_card(path, COMMAND, recipe.command, train, validation, started_from)


def _site_of(stream: GridStream) -> str:
    """The site of the weights that a training writes. Raises ConfigurationError for the name of general weights."""
    if stream.site == GENERAL:
        raise ConfigurationError(
            f"{stream.name}: its site is '{GENERAL}', the name of weights for any place: import it again with another"
            " --site"
        )
    return stream.site


def _what_is_kept(path: Path, *, written: bool) -> str:
    """The result of an interrupted training, and how to continue, in one line; `written`: it has written a card."""
    again = "the same command continues it"
    if not can_continue(_log_folder(path)):
        again = "there is no checkpoint: the same command begins again"
    if not path.exists():
        return f"interrupted before there were weights; {again}"
    reached = read_card(path).interrupted
    if reached:
        return f"interrupted at {reached}; {path} has the best so far; {again}"
    if written:
        return f"interrupted; {path} has the weights without later stages, such as classes; {again}"
    return f"interrupted; {path} keeps the weights of an earlier training; {again}"


def _stretches(
    recipe: Recipe, named: Mapping[str, Sequence[NamedStretch]], cache: FileCache, progress: Progress
) -> tuple[list[GridStream], list[GridStream]]:
    """The stretches to train on and to validate on, `named` by use. Raises ConfigurationError, RecordingError, and
    WeightsError if stretches of a site differ in grid, period or site."""
    grid = GridSpec.parse(recipe.grid) if recipe.grid else None
    opened: dict[str, list[GridStream]] = {TRAIN: [], VALIDATION: []}
    with progress.stage("recording", sum(map(len, named.values()))) as stage:
        for use, found in named.items():
            for path, stretch in found:
                recording = surveyed(open_recording(path, format=recipe.format), cache)
                opened[use].append(_stretch(recording, stretch, use, grid, recipe.rate_hz))
                stage.advance(path.name)
    train_on, validate_on = opened[TRAIN], opened[VALIDATION]
    if not recipe.general:
        _refuse_unlike_places([*train_on, *validate_on])
    validate_on = validate_on or _own_validation(recipe, train_on)
    _refuse_shared(train_on, validate_on)
    return train_on, validate_on


def _data_of(streams: Sequence[GridStream]) -> list[TrainingData]:
    """Fingerprints of the frames of `streams`, which identify them under other names and ranges."""
    recorded = [(stream, stream.recorded) for stream in streams]
    return [
        TrainingData(
            recording=stream.name,
            sha256=stream.sha256,
            site=stream.site,
            source_sha256=time.source_sha256,
            start_ns=time.start_ns,
            end_ns=time.end_ns,
        )
        for stream, time in recorded
    ]


def _log_folder(path: Path) -> Path:
    """The folder of logs and checkpoints beside a card."""
    return path.with_suffix(".logs")


def _more(streams: Sequence[GridStream]) -> str:
    """How many streams are beyond the ones that are named, as text."""
    more = len(streams) - NAMED_STRETCHES
    return f" and {more} more" if more > 0 else ""


def _make_folder(folder: Path) -> None:
    """Refuse a folder that cannot be written to before the training, which may take hours."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigurationError(
            f"{folder}: cannot be made ({error.strerror}); name a folder for weights with --out"
        ) from None
    if not os.access(folder, os.W_OK):
        raise ConfigurationError(f"{folder}: may not be written to; name another folder for weights with --out")


def _named(texts: Sequence[str], recipe: Recipe, report: Callable[[str], None]) -> list[NamedStretch]:
    """The recordings and stretches of each RECORDING[@range], or of all recordings in a folder."""
    named = [(found, part) for path, part in map(parse_stretch, texts) for found in recordings_at(path, recipe.format)]
    return [(posed_copy(path, recipe.ego_motion, recipe.format, report), stretch) for path, stretch in named]


def _each_of(text: str, format: str | None) -> list[str]:
    """RECORDING[@range] of each recording that `text` names; a URL unchanged."""
    if is_url(text):
        return [text]
    path, stretch = parse_stretch(text)
    range_ = "" if stretch is None else f"@{text.rpartition('@')[2]}"
    return [f"{found}{range_}" for found in recordings_at(path, format)]


def _stretch(
    recording: Recording, stretch: Stretch | str | None, use: str, grid: GridSpec | None, rate_hz: float | None
) -> GridStream:
    """The `stretch` of a recording, or its own one for this `use`, or all of a recording without any."""
    refuse_unmeasured(recording)
    own, path = recording.info.stretches, recording.path
    if stretch is None and own and use not in own:
        raise ConfigurationError(
            f"{path}: it names no stretch '{use}'; name one of its own ({', '.join(f'{path}@{name}' for name in own)}),"
            f" or seconds ({path}@{stretch_text((0.0, recording.survey.whole_s))})"
        )
    return GridStream(recording, use if stretch is None and own else stretch, grid=grid, rate_hz=rate_hz)


def _of_test_stretches(streams: Sequence[GridStream]) -> Iterator[str]:
    """A line for each stretch that has frames of its recording's test stretch and is not named so."""
    for stream in streams:
        test = stream.recording.info.stretches.get(TEST)
        named = f"{stream.recording.name}@{TEST}"
        if test and stream.name != named and _overlap(stream.stretch_s, test):
            yield (
                f"{stream.name} has frames of the recording's stretch '{TEST}' ({stretch_text(test)}): these weights"
                f" cannot be compared there; name {named} if that is meant"
            )


def _overlap(one: Stretch, other: Stretch) -> bool:
    """Whether two stretches of a recording have a time in common; an end of None is the recording's."""
    ends_s = [math.inf if end_s is None else end_s for _, end_s in (one, other)]
    return max(one[0], other[0]) < min(ends_s)


def _own_validation(recipe: Recipe, train_on: Sequence[GridStream]) -> list[GridStream]:
    found = [own_validation(stream) for stream in train_on if VALIDATION in stream.recording.info.stretches]
    if not found:
        cut = in_two(train_on[0])
        recordings = (
            cut.recording,
            *[text for named in recipe.recordings for text in _each_of(named, recipe.format)][1:],
        )
        command = recipe.model_copy(update={"recordings": recordings, "validation": (cut.validation,)}).command
        raise ConfigurationError(
            f"{train_on[0].name}: no validation stretch; name one with --validation, or run `{command}`"
        )
    return found


def _refuse_unlike_places(streams: Sequence[GridStream]) -> None:
    """Raise WeightsError for the first stretch of another grid, period or site than the first of all."""
    first = streams[0]
    for stream in streams[1:]:
        here, there = _place(first), _place(stream)
        differing = [name for name in here if here[name] != there[name]]
        if differing:
            others = " and ".join(f"the {name} {there[name]}" for name in differing)
            own = " and ".join(here[name] for name in differing)
            raise WeightsError(
                f"{stream.name} has {others}, but {first.name} {own}: train and validate on recordings of one grid,"
                " period and site, or for any place with --general"
            )


def _place(stream: GridStream) -> dict[str, str]:
    """The site, grid and period that weights of a site are made for, as text."""
    return {"site": f"'{stream.site}'", "grid": str(stream.grid), "period": f"{stream.period_s} s"}


def _refuse_shared(train_on: Sequence[GridStream], validate_on: Sequence[GridStream]) -> None:
    for stream in train_on:
        for other in validate_on:
            if shares_frames(stream, other):
                raise ConfigurationError(
                    f"{other.name} shares frames with {stream.name}: validate on frames that are not trained on"
                )


def general_start(
    recipe: Recipe, validation: Sequence[GridStream], folder: Path, report: Callable[[str], None], *, can_start: bool
) -> LearnedWeights | None:
    """The general weights that a training starts from, copied to `folder`; None from scratch. A line reports which.

    At a site they are those that `compare` would find. `can_start`: whether the tracker can start from weights. Raises
    WeightsError, and ConfigurationError if they learned from frames of `validation`.
    """
    if not can_start:
        if recipe.weights:
            report(f"from scratch: a training of {recipe.tracker} does not start from weights; --weights has no effect")
        return None
    if recipe.from_scratch:
        report("from scratch, not from general weights")
        return None
    if recipe.general and not recipe.weights:
        report("from scratch: a general training starts from general weights only if --weights names their folder")
        return None
    found = find_weights(recipe.tracker, GENERAL, Path(recipe.weights) if recipe.weights else None, "general")
    if found is None:
        report(f"from scratch: there are no general weights of {recipe.tracker}")
        return None
    _refuse_seen(found, validation)
    start = copy_weights(found, folder)
    report(f"starts from the general weights {start.name}, sha256 {start.sha256[:12]}")
    return start


def _refuse_seen(found: LearnedWeights, validation: Sequence[GridStream]) -> None:
    """Refuse weights that learned from the validation stretch: a selection there would be worthless."""
    for stream in validation:
        for data in found.card.train:
            if common_with(stream, data) is not None:
                raise ConfigurationError(
                    f"{found.name} was trained on {data.recording}, which has frames of {stream.name}: validate on"
                    " other frames, or train with --from-scratch"
                )


HORIZON_STEP_S, LAST_S = 0.1, 2.5
"""A card has thresholds for horizons in steps of HORIZON_STEP_S up to LAST_S; the last one counts beyond it too."""
FORECAST_EVERY_S = 1.0
THRESHOLDS_LOG = "thresholds.log"
THRESHOLDS_LIMITS = Limits(predict_s=600.0)
"""Nobody waits for these forecasts: a tracker may be slower than in a comparison."""


def choose_card_thresholds(
    row: Selection, path: Path, validation: Sequence[tuple[GridStream, CellKinds]], progress: Progress
) -> CardThresholds | None:
    """The thresholds with the best F1 of a `row` with the weights at `path`, on all `validation` stretches together.

    Each with the kinds of its cells, which the training found on its own stretches: nothing is found on the rest of a
    recording, which may be scored later. None if all of them are too short. Raises TrialEnded if the tracker
    fails, RecordingError.
    """
    validation = [(stream, kinds) for stream, kinds in validation if _steps(stream)]
    if not validation:
        return None
    strata = STRATA_WITH_TRUTH if all(stream.has_truth for stream, _ in validation) else STRATA
    total = Tally.empty(round(LAST_S / HORIZON_STEP_S), strata)
    with progress.stage("thresholds on recording", len(validation)) as stage:
        for stream, kinds in validation:
            _add(total, _tally(row, path, stream, kinds, progress).of(strata), stream.period_s)
            stage.advance()
    bins = _filled(best_thresholds(total, "").bins, total.positives.sum(axis=2) > 0)
    values = Thresholds(bins, strata=strata).values
    return CardThresholds(
        step_s=HORIZON_STEP_S, values={name: tuple(values[:, k].tolist()) for k, name in enumerate(strata)}
    )


def _steps(stream: GridStream) -> int:
    """Steps of the forecasts from a stretch: up to LAST_S, and so few that half of a short stretch is forecast from."""
    return min(nearest_step(LAST_S, stream.period_s), (len(stream) - WARM_UP) // 2)


def _tally(row: Selection, path: Path, stream: GridStream, kinds: CellKinds, progress: Progress) -> Tally:
    """The counts on one stretch with these `kinds` of its cells, by its own steps."""
    recording, every = stream.recording.path, max(1, round(FORECAST_EVERY_S / stream.period_s))
    split = EvaluationSplit(recording.stem, recording, stream, stream, _steps(stream), every)
    weights = LearnedWeights(path, read_card(path), sha256_of(path), path.parent)
    trial = Trial(row, launch(row.name), split, weights, seed=0, limits=THRESHOLDS_LIMITS)
    log = path.with_suffix(".logs") / THRESHOLDS_LOG
    log.parent.mkdir(exist_ok=True)
    with trial.tracker_process(log) as process, progress.stage("frame", len(stream)) as frames:
        delivery = Delivery(moments(stream, Regions(stream.grid, kinds, split.strata)), frames.advance)
        return validation_tally(process, delivery, split, seed=0)


def _add(total: Tally, counted: Tally, period_s: float) -> None:
    """Add counts by steps of `period_s` to those by steps of HORIZON_STEP_S: each to the nearest horizon."""
    nearest = np.rint(np.arange(len(counted.cells)) * period_s / HORIZON_STEP_S).astype(np.int64)
    kept = nearest < len(total.cells)
    np.add.at(total.cells, nearest[kept], counted.cells[kept])
    np.add.at(total.positives, nearest[kept], counted.positives[kept])


def _filled(bins: NDArray[np.int64], known: NDArray[np.bool_]) -> NDArray[np.int64]:
    """The `bins` (S, K); bins that are not `known` (S, K) come from the nearest known step; 0.5 without any."""
    filled = np.full_like(bins, HALF)
    for k in range(bins.shape[1]):
        steps = np.flatnonzero(known[:, k])
        if len(steps):
            nearest = np.abs(np.arange(len(bins))[:, None] - steps).argmin(axis=1)
            filled[:, k] = bins[steps[nearest], k]
    return filled
