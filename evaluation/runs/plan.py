"""The plan of a comparison: its settings resolved to one trial for each tracker on each recording."""

from __future__ import annotations

import shlex
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

from gridtrack.common.entry_points import VALID_NAME
from gridtrack.common.errors import ConfigurationError, PluginError, WeightsError, did_you_mean
from gridtrack.common.files import check_path
from gridtrack.common.grid import GridSpec
from gridtrack.common.notices import Notice
from gridtrack.evaluation.hosting.limits import Limits
from gridtrack.evaluation.hosting.sandbox import check_sandbox
from gridtrack.evaluation.hosting.tracker_process import TrackerProcess, describe
from gridtrack.evaluation.referee.splits import (
    ORACLE,
    USUAL_EVERY_S,
    EvaluationSplit,
    Sampling,
    plan_splits,
    segments_of,
    with_points,
)
from gridtrack.evaluation.referee.strata import OCCLUDED, SCORING_RULES
from gridtrack.evaluation.runs.learned import (
    LearnedWeights,
    copy_weights,
    find_weights,
    leaks_of,
    weights_in,
)
from gridtrack.evaluation.runs.recorded_rows import check_recorded, hash_of_file, recorded_file, with_own_file
from gridtrack.evaluation.runs.run_record import RunConfiguration, TrialIdentity, identity_of
from gridtrack.evaluation.runs.settings import CompareSettings, check_together
from gridtrack.evaluation.runs.summary import ALL_RECORDINGS
from gridtrack.evaluation.runs.training_hints import stretches_to_train_on
from gridtrack.evaluation.scores.definition import ScoreDefinition
from gridtrack.evaluation.scores.registry import scores
from gridtrack.evaluation.scores.robot import SMALL_ROBOT, Robot
from gridtrack.recordings.importing import posed_copy
from gridtrack.recordings.stream import GridStream
from gridtrack.recordings.stretches import parse_stretch
from gridtrack.trackers import registry
from gridtrack.trackers.contract import stream_of
from gridtrack.trackers.selection import (
    CardKind,
    Launch,
    Selection,
    is_plugin,
    launch,
    parse_selections,
    read_trackers_toml,
)
from gridtrack.trackers.training.weights import fitted_card

SCORED_CELLS_PER_S, LONG_MINUTES = 2e7, 10
"""Cells of forecasts that one processor scores in a second (`compare --tracker blank` on grids of 100 and 400 cells a
side), and the time from which an estimate is a notice."""
UNTRAINED = "left out: no weights of it are installed; train it (`gridtrack trackers list` shows all), or name it"


@dataclass(frozen=True, slots=True)
class Trial:
    """One tracker on one recording, with everything that is needed to run it."""

    selection: Selection
    launch: Launch
    split: EvaluationSplit
    weights: LearnedWeights | None
    seed: int
    limits: Limits
    others: tuple[EvaluationSplit, ...] = ()
    """The other splits of its recording, on which its tracker must not be trained either."""
    scores: tuple[str, ...] = ()
    """Names of the scores of other packages by which it is scored."""
    robot: Robot = SMALL_ROBOT
    """The virtual robot of contact foresight."""
    file_sha256: str = ""
    """Of the file of recorded forecasts."""

    @property
    def label(self) -> str:
        """The tracker's label in this run."""
        return self.selection.label

    @property
    def name(self) -> str:
        """The name of the trial's folder."""
        return f"{self.label}@{self.split.name}"

    @property
    def is_users(self) -> bool:
        """Whether its tracker is the user's: it is not one of gridtrack."""
        return self.launch.external or is_plugin(self.launch)

    @property
    def recorded(self) -> Path | None:
        """The file of a row of recorded forecasts; None for a tracker. Raises ConfigurationError without a file."""
        return recorded_file(self.selection) if self.selection.name in registry.recorded() else None

    @property
    def test(self) -> GridStream:
        """The test stretch, with the returns that this tracker requested."""
        return with_points(self.split.test, self.selection.points)

    @property
    def validation(self) -> GridStream | None:
        """The stretch on which thresholds are chosen, with the requested returns, or None."""
        stretch = self.split.validation
        return stretch and with_points(stretch, self.selection.points)

    def beyond_training(self) -> Iterator[Notice]:
        """A notice if its general weights were trained on other cell sizes or periods than the stream's."""
        beyond = self.weights and self.weights.card.beyond_training(self.test.grid.cell_m, self.test.period_s)
        if beyond:
            yield self.notice(
                f"its general weights were trained on {beyond}",
                "general weights were trained on other cell sizes or periods",
            )

    def notice(self, text: str, kind: str = "") -> Notice:
        """A notice about this row on its recording."""
        return Notice(text=text, row=self.label, recording=self.split.name, kind=kind)

    @property
    def leaks(self) -> tuple[str, ...]:
        """Scored frames, and frames for thresholds, that its weights learned from."""
        return leaks_of(self.split, self.weights)

    def tracker_process(self, log: Path, *, scored: bool = False) -> TrackerProcess:
        """The tracker, not started yet, on the test stretch's grid and period; its stderr goes to `log`.

        `scored`: whether its forecasts get all scores of a trial, such as scores of classes and velocities.
        """
        stream = replace(stream_of(self.test), velocity_scored=scored and OCCLUDED in self.split.strata)
        if self.weights:
            stream = replace(stream, weights=self.weights.path, weights_sha256=self.weights.sha256)
        stretches = (self.split.test, self.split.validation)
        return TrackerProcess(
            self.launch,
            stream,
            self.selection.options,
            self.limits,
            log,
            [stretch.recording.path for stretch in stretches if stretch],
            (self.recorded,) if self.recorded else (),
            classes_used=scored and bool(stream.classes),
        )

    def with_original_paths(self, reason: str) -> str:
        """`reason` with the original folder of the weights in place of the folder of their copy."""
        return reason.replace(str(self.weights.path.parent), str(self.weights.original)) if self.weights else reason

    @property
    def how_to_train(self) -> str:
        """The reason of the outcome `untrained`: how to train the tracker at the recording's site, in one line."""
        missing = f"no weights for site '{self.split.test.site}'"
        if self.launch.external:
            return f"{missing}; train it where it is installed, and name the folder of its weights with --weights"
        stretches = stretches_to_train_on(self.split, self.others)
        if stretches is None:
            return f"{missing}; train it on a longer recording of this site: this one has no part to spare"
        command = shlex.join(
            ["gridtrack", "train", self.selection.name, *stretches.arguments, *self._sampling_options()]
        )
        then = f"the rest, {stretches.compare}, into another folder" if stretches.compare else "again with --resume"
        return f"{missing}; run `{command}`, then compare {then}, or name a folder of weights with --weights"

    def _sampling_options(self) -> list[str]:
        """The grid and rate of this comparison as command-line options, if they differ from the recording's own."""
        test = self.split.test
        own = GridStream(test.recording)
        grid = [] if test.grid == own.grid else ["--grid", str(test.grid)]
        return grid if test.period_ns == own.period_ns else [*grid, "--rate", f"{1 / test.period_s:g}"]

    def identity(self) -> TrialIdentity:
        """All that the scores depend on, except learned weights; a resumed run keeps scores of the same identity."""
        return TrialIdentity(
            tracker=self.selection.name,
            options=dict(self.selection.options),
            points=self.selection.points,
            argv=tuple(self.launch.argv if self.launch.external else self.launch.argv[1:]),
            seed=self.seed,
            threads=self.limits.threads,
            file_sha256=self.file_sha256,
        )


@dataclass(frozen=True, slots=True)
class ComparisonPlan:
    """A comparison before it runs: settings, splits, trials, and notices for the user."""

    settings: CompareSettings
    splits: tuple[EvaluationSplit, ...]
    trials: tuple[Trial, ...]
    notices: tuple[Notice, ...]

    def identity(self) -> RunConfiguration:
        """The resolved configuration; a resumed run must have the same."""
        return RunConfiguration(
            scoring_rules=SCORING_RULES,
            robot=self.settings.robot,
            recordings={split.name: identity_of(split) for split in self.splits},
            trials={trial.name: trial.identity() for trial in self.trials},
        )


def with_copied_weights(plan: ComparisonPlan, folder: Path) -> ComparisonPlan:
    """`plan` with copies of all weights in `folder`, so that every trial uses the files with the recorded hash.

    Raises WeightsError, OSError.
    """
    found = {trial.weights.path: trial.weights for trial in plan.trials if trial.weights}
    copies = {path: copy_weights(weights, folder / str(n)) for n, (path, weights) in enumerate(found.items())}
    trials = (replace(trial, weights=copies[trial.weights.path]) if trial.weights else trial for trial in plan.trials)
    return replace(plan, trials=tuple(trials))


def sampling_of(settings: CompareSettings) -> Sampling:
    """Horizon, interval, grid and rate as `settings` give them. Raises ConfigurationError."""
    grid = GridSpec.parse(settings.grid) if settings.grid else None
    every_s = USUAL_EVERY_S if settings.follow and settings.every_s is None else settings.every_s
    return Sampling(settings.horizon_s, every_s, grid, settings.rate_hz, settings.format)


def segmented(whole: EvaluationSplit, settings: CompareSettings) -> Iterable[EvaluationSplit]:
    """The segments of a split that `settings` request, or the split itself."""
    return (whole,) if settings.segment_s is None else segments_of(whole, settings.segment_s, settings.warm_up_s)


def resolve(
    settings: CompareSettings,
    splits: tuple[EvaluationSplit, ...] | None = None,
    note: Callable[[str], None] = lambda line: None,
) -> ComparisonPlan:
    """Look up everything that `settings` names, before any trial runs; `splits` of its recordings if they are known.

    `note` receives a line before the poses of a recording are taken from its scans.

    Raises a GridtrackError for a recording, stretch, tracker, option or weights file that cannot be used.
    """
    check_path(settings.out, ConfigurationError)
    check_together(settings)
    known = scores(settings.scores)  # an unknown one is an error before anything runs
    _refuse_unknown_headline(settings.headline, known)
    if settings.limits.sandbox:
        check_sandbox()
    external = read_trackers_toml(settings.trackers_toml) if settings.trackers_toml else {}
    floors, left_out = _added_floors(settings)
    selections = _selections(settings, external, floors)
    launches = {selection.label: launch(selection.name, external) for selection in selections}
    for selection in selections:
        _check_options(selection, launches[selection.label], settings.limits)
    wholes = splits or _wholes(settings, note)
    splits = tuple(split for whole in wholes for split in segmented(whole, settings))
    _refuse_equal_names(splits)
    _refuse_overlaps(wholes)
    places = {_place_of(split): split for split in splits}
    weights = {
        (selection.label, place): _fitting_weights(selection, split, settings.weights)
        for place, split in places.items()
        for selection in selections
    }
    found = {key: of_row for key, (of_row, _) in weights.items()}
    if not settings.trackers:
        trained = {label for (label, _), of_row in found.items() if of_row is not None}
        untrained = [one for one in selections if one.label not in trained and _is_own_learner(launches[one.label])]
        left_out += [Notice(text=UNTRAINED, row=one.label) for one in untrained]
        selections = tuple(one for one in selections if one not in untrained)
    trials = tuple(_trials(settings, selections, launches, splits, found))
    of_weights = (notice for _, notices in weights.values() for notice in notices)
    notices = [*left_out, *(notice for split in splits for notice in split.notices), *of_weights, *_notices(trials)]
    notices += _leak_notices(settings, trials)
    return ComparisonPlan(settings, splits, trials, tuple(dict.fromkeys(notices)))


def _selections(
    settings: CompareSettings, external: Mapping[str, Launch], floors: Sequence[str]
) -> tuple[Selection, ...]:
    """The rows that the settings name, or every tracker, and the `floors`. Raises ConfigurationError."""
    selections = parse_selections([*(settings.trackers or _every_tracker(external)), *floors])
    _refuse_oracle_label(selections)
    _refuse_unknown_reference(settings.reference, selections)
    _refuse_recorded_live(settings, selections)
    return selections


def _trials(
    settings: CompareSettings,
    selections: Sequence[Selection],
    launches: Mapping[str, Launch],
    splits: Sequence[EvaluationSplit],
    weights: Mapping[tuple[str, tuple[str, str, int]], LearnedWeights | None],
) -> Iterator[Trial]:
    """A trial for each row on each split; `weights` by label and place. Raises ConfigurationError."""
    for split, others in zip(splits, _others_of_recording(splits), strict=True):
        for selection in selections:
            is_recorded = selection.name in registry.recorded()
            own = with_own_file(selection, split) if is_recorded else selection
            trial = Trial(
                own,
                launches[selection.label],
                split,
                weights[selection.label, _place_of(split)],
                settings.seed,
                settings.limits,
                others,
                settings.scores,
                settings.robot,
                hash_of_file(own) if is_recorded else "",
            )
            _refuse_thresholds_of_another_site(trial)
            yield trial


def _leak_notices(settings: CompareSettings, trials: Sequence[Trial]) -> list[Notice]:
    """A notice of each leak. Raises ConfigurationError if they are not allowed."""
    found = [(trial, leak) for trial in trials for leak in trial.leaks]
    leaks = list(dict.fromkeys(leak for _, leak in found))
    if leaks and not settings.allow_leak:
        more = f" (and {len(leaks) - 1} more)" if len(leaks) > 1 else ""
        raise ConfigurationError(
            f"{leaks[0]}{more}: compare on other frames, or with --allow-leak, which marks such rows and does not"
            " rank them"
        )
    kind = "not ranked: learned from frames of the comparison"
    return [trial.notice(f"not ranked: {leak}", kind) for trial, leak in found]


def _notices(trials: Sequence[Trial]) -> Iterator[Notice]:
    """Notices about the trials before they run."""
    for trial in trials:
        if trial.recorded:
            yield from check_recorded(trial.selection, trial.split)
        if trial.limits.sandbox and is_plugin(trial.launch):
            yield _beside_gridtrack(trial.label)
        if trial.weights and trial.weights.card.interrupted:
            name, at = trial.weights.name, trial.weights.card.interrupted
            yield Notice(text=f"{name} is of a training that was interrupted at {at}", row=trial.label)
        yield from trial.beyond_training()
    yield from _large_cost(trials)


def _wholes(settings: CompareSettings, note: Callable[[str], None]) -> tuple[EvaluationSplit, ...]:
    """The split of each recording, with the requested poses."""

    def posed(text: str) -> str:
        path, stretch = parse_stretch(text)
        copy = posed_copy(path, settings.ego_motion, settings.format, note)
        return str(copy) if stretch is None else f"{copy}@{text.rpartition('@')[2]}"

    validation = settings.validation and posed(settings.validation)
    return plan_splits(map(posed, settings.recordings), validation, sampling_of(settings))


def _large_cost(trials: Sequence[Trial]) -> Iterator[Notice]:
    """A notice if scoring will take long: an estimate before anything runs.

    The trials of a row share the thresholds of a validation stretch, so that its forecasts count once.
    """
    scored = [(trial.split, trial.split.schedule) for trial in trials]
    validated = {(trial.label, own.name): trial.split for trial in trials if (own := trial.split.validation)}
    scored += [(split, split.validation_schedule) for split in validated.values()]
    forecasts = sum(schedule.expected for _, schedule in scored)
    cells = sum(schedule.expected * (split.steps + 1) * split.test.grid.size**2 for split, schedule in scored)
    minutes = cells / SCORED_CELLS_PER_S / 60
    if minutes > LONG_MINUTES:
        largest = max((split for split, _ in scored), key=lambda split: (split.steps + 1) * split.test.grid.size**2)
        size = largest.test.grid.size
        yield Notice(
            text=f"scoring {forecasts} forecasts, the largest of {largest.steps + 1} steps on {size} x {size}"
            f" cells, takes about {minutes:.0f} minutes of processor time, besides the trackers' own: fewer cells"
            " (--grid), a shorter --horizon or a longer --every take less"
        )


def _beside_gridtrack(label: str) -> Notice:
    return Notice(
        row=label,
        text="--sandbox confines its process, but its package is installed beside gridtrack, where a package can run"
        " code in gridtrack's own process: install it in an environment of its own, named by `python` in trackers.toml",
    )


def _every_tracker(external: Mapping[str, Launch]) -> tuple[str, ...]:
    """Names of all trackers but the floors, and those that need a file; `gridtrack trackers list` reports trackers that
    cannot be selected."""
    others = {*registry.floors(), *registry.recorded()}
    return (*(name for name in registry.entries() if VALID_NAME.fullmatch(name) and name not in others), *external)


def _is_own_learner(start: Launch) -> bool:
    """Whether a tracker is one of gridtrack's own that learn: all of them but the floors."""
    return not start.external and not is_plugin(start) and start.name not in registry.floors()


def _added_floors(settings: CompareSettings) -> tuple[list[str], list[Notice]]:
    """The rows of the floors that the settings do not name, and a notice of each that cannot run.

    Beside named trackers they have general weights, which learned from no frame of the comparison.
    """
    if settings.no_floors:
        return [], []
    named = {selection.name for selection in parse_selections(settings.trackers)}
    others = {name: entry for name, entry in registry.floors().items() if name not in named}
    why = {name: entry.problem or registry.missing_extra(entry) for name, entry in others.items()}
    rows = [f"{name}:card=general" if settings.trackers else name for name in others if not why[name]]
    return rows, [
        Notice(text=f"a floor that is left out: {problem}", row=name) for name, problem in why.items() if problem
    ]


def _check_options(selection: Selection, start: Launch, limits: Limits) -> None:
    """Let the tracker validate its options; defaults need no check, which would start a process."""
    if not selection.options:
        return
    # a tracker that cannot be loaded ends as `unavailable` in its own trial, and stops no other
    with suppress(PluginError):
        describe(start, selection.options, limits)


def _refuse_unknown_headline(headline: str, known: Sequence[ScoreDefinition]) -> None:
    """Raise ConfigurationError for a score that does not exist, or by which trackers are not compared."""
    names = [score.name for score in known if score.lead.tested]
    if headline and headline not in names:
        raise ConfigurationError(
            f"--headline: trackers are not compared by '{headline}': {did_you_mean(headline, names)}"
        )


def _refuse_oracle_label(selections: Sequence[Selection]) -> None:
    if any(selection.label.casefold() == ORACLE for selection in selections):
        raise ConfigurationError(
            f"'{ORACLE}' is the referee's own row, the ceiling of the scores: give the tracker another label,"
            " as in --tracker LABEL=NAME"
        )


def _refuse_recorded_live(settings: CompareSettings, selections: Sequence[Selection]) -> None:
    recorded = [selection.label for selection in selections if selection.name in registry.recorded()]
    if recorded and settings.follow:
        raise ConfigurationError(f"--follow: {recorded[0]} reads recorded forecasts: compare the finished recording")


def _refuse_unknown_reference(reference: str | None, selections: Sequence[Selection]) -> None:
    labels = [selection.label for selection in selections]
    if reference is not None and reference not in labels:
        raise ConfigurationError(f"--reference {reference}: no such label; {did_you_mean(reference, labels)}")


def _refuse_equal_names(splits: tuple[EvaluationSplit, ...]) -> None:
    seen: dict[str, Path] = {}
    for split in splits:
        if split.name == ALL_RECORDINGS:
            raise ConfigurationError(
                f"{split.path}: '{ALL_RECORDINGS}' is the name of all recordings together: rename the file"
            )
        if split.name in seen:
            raise ConfigurationError(
                f"{seen[split.name]} and {split.path} would both be called '{split.name}' in the results: name each"
                " recording and stretch once, and rename one of two files with the same name"
            )
        seen[split.name] = split.path


def _refuse_overlaps(splits: tuple[EvaluationSplit, ...]) -> None:
    """Refuse stretches that overlap: a repeated frame would look like more evidence."""
    for one, other in combinations(splits, 2):
        times = one.test.recorded, other.test.recorded
        if times[0].source_sha256 == times[1].source_sha256 and times[0].overlaps(times[1]):
            shared_ns = min(time.end_ns for time in times) - max(time.start_ns for time in times)
            raise ConfigurationError(
                f"{one.test.name} and {other.test.name} are of one source and have {shared_ns / 1e9:.10g} s in common:"
                " leave one out, or name stretches that do not overlap"
            )


def _others_of_recording(splits: Sequence[EvaluationSplit]) -> Iterator[tuple[EvaluationSplit, ...]]:
    """For each split the others of its recording."""
    of_path: dict[Path, list[EvaluationSplit]] = defaultdict(list)
    for split in splits:
        of_path[split.path].append(split)
    return (tuple(other for other in of_path[split.path] if other is not split) for split in splits)


def _refuse_thresholds_of_another_site(trial: Trial) -> None:
    """The map, the calibration and the thresholds of one site do not hold at another one."""
    site, validation = trial.split.test.site, trial.split.validation
    if trial.weights is None or trial.weights.card.general or validation is None or validation.site == site:
        return
    raise ConfigurationError(
        f"{trial.label}: its weights are of the site '{site}', and its thresholds would be chosen on {validation.name}"
        f" of the site '{validation.site}': name a --validation stretch of the site '{site}', or compare general"
        f" weights (--tracker {trial.selection.name}:card=general)"
    )


def _place_of(split: EvaluationSplit) -> tuple[str, str, int]:
    """Site, grid and period, on which the weights of a row depend."""
    return split.test.site, str(split.test.grid), split.test.period_ns


def _fitting_weights(
    selection: Selection, split: EvaluationSplit, override: Path | None
) -> tuple[LearnedWeights | None, tuple[Notice, ...]]:
    """The weights of a row, with a notice if general ones replace weights of the site that do not fit grid or rate.

    Raises WeightsError if the row's own folder has none.
    """
    test = split.test
    found = _weights_of(selection, test.site, override, selection.card)
    if found is None or selection.card != "any":
        return found, ()
    try:
        fitted_card(found.card, found.path, stream_of(test))
    except WeightsError as misfit:
        with suppress(WeightsError):
            general = _weights_of(selection, test.site, override, "general")
            if general is not None:
                why = str(misfit).removeprefix(f"{found.path}: ").partition(": ")[0]
                used = "general weights are used, as with card=general"
                text = f"its weights of the site '{test.site}' are {why}; {used}"
                kind = f"the weights of the site do not fit; {used}"
                return general, (Notice(text=text, row=selection.label, recording=split.name, kind=kind),)
    return found, ()


def _weights_of(selection: Selection, site: str, override: Path | None, kind: CardKind) -> LearnedWeights | None:
    """The weights of a row of this kind. Raises WeightsError if the row's own folder has none."""
    if selection.weights is None:
        return find_weights(selection.name, site, override, kind)
    return weights_in(selection.weights, selection.name, site, kind)
