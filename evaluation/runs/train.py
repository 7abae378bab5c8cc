"""Training of a tracker by a recipe, for a site or for any place: `gridtrack train`."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from gridtrack.common.cache import FileCache
from gridtrack.common.errors import ConfigurationError, WeightsError
from gridtrack.common.grid import GridSpec
from gridtrack.common.remote_files import is_url
from gridtrack.evaluation.runs.card_thresholds import choose_card_thresholds
from gridtrack.evaluation.runs.general_start import general_start
from gridtrack.evaluation.runs.learned import LearnedWeights, user_weights_folder, weights_path
from gridtrack.evaluation.runs.progress_lines import ProgressLines
from gridtrack.evaluation.runs.recipe import Recipe, with_local_copies
from gridtrack.evaluation.runs.stretch_files import StretchFiles, stretch_cache, surveyed
from gridtrack.evaluation.runs.training_hints import in_two
from gridtrack.evaluation.runs.training_process import TrainingProcess
from gridtrack.evaluation.scoring.splits import TRAIN, VALIDATION, own_validation, shares_frames
from gridtrack.evaluation.scoring.world_kinds import CellKinds
from gridtrack.recordings import Recording, open_recording, recordings_at
from gridtrack.recordings.recording_info import Stretch, stretch_text
from gridtrack.recordings.stream import GridStream
from gridtrack.recordings.stretches import parse_stretch
from gridtrack.trackers.card import GENERAL, StartedFrom, TrainingData
from gridtrack.trackers.contract import FitOutput
from gridtrack.trackers.progress import Progress
from gridtrack.trackers.weights import add_thresholds, complete_card, read_card

NamedStretch = tuple[Path, Stretch | str | None]
"""A recording, and what is named of it: a stretch, its name, or nothing."""
COMMAND = "the command of the training"
"""What `fit` receives in place of the command, which names the files of recordings; the card gets the command after."""


def train_tracker(recipe: Recipe, report: Callable[[str], None] = print) -> Path:
    """Fit the recipe's tracker to the recordings and return the card it wrote, `<out>/<tracker>/<site>.toml`.

    A general training writes `general.toml`. One at a site starts from general weights, where there are some and the
    tracker can; a general one where the recipe names some.

    A recording without a range, and validation where none is given, is the recording's stretch of that name. `fit` runs
    in a process of its own, which receives the frames of these stretches and nothing else of the recordings. Logs and
    checkpoints are written beside the card to `<site>.logs`; a second call resumes there. Raises GridtrackError, and
    KeyboardInterrupt with a line about what is kept.
    """
    cache, local = stretch_cache(report), with_local_copies(recipe, report)
    named = {use: _named(texts) for use, texts in ((TRAIN, local.recordings), (VALIDATION, local.validation))}
    with (
        TrainingProcess(recipe.tracker, [path for found in named.values() for path, _ in found]) as process,
        TemporaryDirectory(prefix="gridtrack-train-") as folder,
    ):
        can_start = process.load(recipe.options, general=recipe.general)
        with ProgressLines(report) as lines:
            train_on, validate_on = _stretches(recipe, named, cache, lines.progress)
        start = general_start(local, validate_on, Path(folder), report, can_start=can_start)
        if can_start and start is None and not recipe.general:
            recipe = recipe.model_copy(update={"from_scratch": True})
        site = GENERAL if recipe.general else _site_of(train_on[0])
        path = weights_path(recipe.out or user_weights_folder(), recipe.tracker, site)
        _make_folder(path.parent)
        logs = path.with_suffix(".logs")
        from_weights = start.path if start else None
        output = FitOutput(path, COMMAND, recipe.seed, logs, report, general=recipe.general, start=from_weights)
        stretches = StretchFiles([*train_on, *validate_on], Path(folder), cache)
        with ProgressLines(report) as lines:
            files = stretches.frames(lines.progress)
        train, validation = files[: len(train_on)], files[len(train_on) :]
        try:
            process.fit(train, validation, output, stretches.regions)
        except KeyboardInterrupt:
            interrupted = True
        else:
            interrupted = False
        finally:
            written = path.exists() and _complete(path, recipe, train_on, validate_on, start)
        if interrupted:
            raise KeyboardInterrupt(_what_is_kept(path, written=written))
        report("thresholds for recordings without a validation stretch")
        try:
            with ProgressLines(report) as lines:
                kinds_of = [stretches.kinds(len(train_on) + n) for n in range(len(validate_on))]
                _add_thresholds(recipe.tracker, path, list(zip(validate_on, kinds_of, strict=True)), lines.progress)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(f"interrupted; {path} is complete, but without thresholds") from None
    return path


def _add_thresholds(
    tracker: str, path: Path, validation: Sequence[tuple[GridStream, CellKinds]], progress: Progress
) -> None:
    """Choose the thresholds of the card at `path` on streams, each with the kinds of its cells."""
    thresholds = choose_card_thresholds(tracker, path, validation, progress)
    if thresholds is not None:
        add_thresholds(path, thresholds)


def _complete(
    path: Path,
    recipe: Recipe,
    train_on: Sequence[GridStream],
    validate_on: Sequence[GridStream],
    start: LearnedWeights | None,
) -> bool:
    """Write command, training data and start on the card that a `fit` wrote. Whether it wrote one."""
    train, validation = _data_of(train_on), _data_of(validate_on)
    if start is None:
        return complete_card(path, COMMAND, recipe.command, train, validation)
    started_from = StartedFrom(name=start.name, sha256=start.sha256)
    train, validation = [*train, *start.card.train], [*validation, *start.card.validation]
    return complete_card(path, COMMAND, recipe.command, train, validation, started_from)


def _site_of(stream: GridStream) -> str:
    """The site whose weights a training writes. Raises ConfigurationError for the name of general weights."""
    if stream.site == GENERAL:
        raise ConfigurationError(
            f"{stream.name}: its site is '{GENERAL}', the name of weights for any place: import it again with another"
            " --site"
        )
    return stream.site


def _what_is_kept(path: Path, *, written: bool) -> str:
    """What an interrupted training leaves, and how to go on, in one line; `written`: it has written a card."""
    again = "the same command goes on"
    if not path.exists():
        return f"interrupted before there was a result; {again}"
    reached = read_card(path).interrupted
    if reached:
        return f"interrupted at {reached}; {path} has the best so far; {again}"
    if written:
        return f"interrupted; {path} has the weights, but not what is learned after them, as classes; {again}"
    return f"interrupted; {path} keeps the weights of an earlier training; {again}"


def _stretches(
    recipe: Recipe, named: Mapping[str, Sequence[NamedStretch]], cache: FileCache, progress: Progress
) -> tuple[list[GridStream], list[GridStream]]:
    """The stretches to train on and to validate on, `named` by use. Raises ConfigurationError, RecordingError, and
    WeightsError where those of a site differ in grid, period or site."""
    grid = GridSpec.parse(recipe.grid) if recipe.grid else None
    opened: dict[str, list[GridStream]] = {TRAIN: [], VALIDATION: []}
    with progress.stage("recording", sum(map(len, named.values()))) as stage:
        for use, found in named.items():
            for path, stretch in found:
                recording = surveyed(open_recording(path), cache)
                opened[use].append(_stretch(recording, stretch, use, grid, recipe.rate_hz))
                stage.advance(path.name)
    train_on, validate_on = opened[TRAIN], opened[VALIDATION]
    if not recipe.general:
        _refuse_unlike_places([*train_on, *validate_on])
    validate_on = validate_on or _own_validation(recipe, train_on)
    _refuse_shared(train_on, validate_on)
    return train_on, validate_on


def _data_of(streams: Sequence[GridStream]) -> list[TrainingData]:
    """What tells the frames of `streams` again, under whatever name or cut their recordings come."""
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


def _make_folder(folder: Path) -> None:
    """Made before the training, which may take hours: a folder that cannot be written to is refused at once."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigurationError(
            f"{folder}: cannot be made ({error.strerror}); name a folder for weights with --out"
        ) from None
    if not os.access(folder, os.W_OK):
        raise ConfigurationError(f"{folder}: may not be written to; name another folder for weights with --out")


def _named(texts: Sequence[str]) -> list[NamedStretch]:
    """What each RECORDING[@range] names: a recording and its stretch, or those of all recordings in a folder."""
    parsed = map(parse_stretch, texts)
    return [(found, stretch) for path, stretch in parsed for found in recordings_at(path)]


def _each_of(text: str) -> list[str]:
    """RECORDING[@range] of each recording that `text` names, as of `_named`; a URL as it is."""
    if is_url(text):
        return [text]
    path, stretch = parse_stretch(text)
    of_it = "" if stretch is None else f"@{text.rpartition('@')[2]}"
    return [f"{found}{of_it}" for found in recordings_at(path)]


def _stretch(
    recording: Recording, stretch: Stretch | str | None, use: str, grid: GridSpec | None, rate_hz: float | None
) -> GridStream:
    """The `stretch` of a recording, or its own for this use, or the whole of a recording without any."""
    own, path = recording.info.stretches, recording.path
    if stretch is None and own and use not in own:
        raise ConfigurationError(
            f"{path}: it names no stretch '{use}'; name one of its own ({', '.join(f'{path}@{name}' for name in own)}),"
            f" or seconds ({path}@{stretch_text((0.0, recording.survey.whole_s))})"
        )
    return GridStream(recording, use if stretch is None and own else stretch, grid=grid, rate_hz=rate_hz)


def _own_validation(recipe: Recipe, train_on: Sequence[GridStream]) -> list[GridStream]:
    found = [own_validation(stream) for stream in train_on if VALIDATION in stream.recording.info.stretches]
    if not found:
        cut = in_two(train_on[0])
        recordings = (cut.recording, *[text for named in recipe.recordings for text in _each_of(named)][1:])
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
        differing = [what for what in here if here[what] != there[what]]
        if differing:
            others = " and ".join(f"the {what} {there[what]}" for what in differing)
            own = " and ".join(here[what] for what in differing)
            raise WeightsError(
                f"{stream.name} has {others}, but {first.name} {own}: train and validate on recordings of one grid,"
                " period and site, or for any place with --general"
            )


def _place(stream: GridStream) -> dict[str, str]:
    """What the weights of a site are made for, by its name."""
    return {"site": f"'{stream.site}'", "grid": str(stream.grid), "period": f"{stream.period_s} s"}


def _refuse_shared(train_on: Sequence[GridStream], validate_on: Sequence[GridStream]) -> None:
    for stream in train_on:
        for other in validate_on:
            if shares_frames(stream, other):
                raise ConfigurationError(
                    f"{other.name} shares frames with {stream.name}: validate on frames that are not trained on"
                )
