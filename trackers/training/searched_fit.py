"""Training of a tracker by a search of its settings: the same search and calibration for every such tracker.

The caller counts the arrays of the site. Then the settings with the best selection score (excerpts.py) on excerpts of
the training recordings are searched, the validation recordings decide between the best of them, and the forecast is
calibrated on the same excerpts. A training that starts from general weights searches near their settings, because a
stretch of a minute has too little motion to find better ones from scratch. It searches the settings that weigh the map
of the place against the stream in their whole range, because general weights have no map. The search runs on the frames
that the map was made of, on which it is always right, so the validation recordings decide whether it does harm: on the
map of a short training everything that stood all the time, such as a queue of cars, is a wall.
"""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.config import Settings
from gridtrack.common.errors import ConfigurationError, RecordingError
from gridtrack.common.files import read_bounded, write_text
from gridtrack.common.untrusted import parse_json
from gridtrack.trackers.contract import FitTask, FrameSource, StretchScore, stream_of
from gridtrack.trackers.registry import registered_name
from gridtrack.trackers.training.calibration import FITTED_S, IDENTITY, CalibratedTracker, fit_calibration
from gridtrack.trackers.training.card import card_for
from gridtrack.trackers.training.excerpts import (
    SELECTION_HORIZONS_S,
    mean_of_defined,
    searched_excerpts,
    selection_curves,
    selection_scores,
    step_of,
)
from gridtrack.trackers.training.weights import SEARCH_FILE, load_start, save_interrupted, save_weights, tuned_settings

if TYPE_CHECKING:
    import optuna

SEARCH_ITERATIONS = 60
SELECTION_SCORE = "selection score"
"""Its name in reports: the mean of `selection_scores`."""
MAP_WORTH = 0.01
"""The map of the place is not used if the selection score is better by this much without it; that score does not count
hidden cells, which only the map knows."""
NEAR = 2.0
"""Greatest factor between a setting of general weights and the same one of a search that starts from them."""

_Searched = TypeVar("_Searched", bound=Settings)


@dataclass(frozen=True, slots=True)
class SettingsSearch(Generic[_Searched]):
    """The search for a `tracker`: settings of one `kind`, with the `ranges` that are searched log-uniformly.

    `of_place`: the settings about the place, which general weights do not know. `during(settings)`: faster, less
    accurate settings for the search. `without_map`: the settings with which the tracker starts without its map of the
    place; empty if it has no map, or cannot start without it.
    """

    tracker: type[CalibratedTracker]
    kind: type[_Searched]
    ranges: Mapping[str, tuple[float, float]]
    of_place: frozenset[str]
    during: Callable[[_Searched], _Searched] = lambda settings: settings
    without_map: Mapping[str, Any] = field(default_factory=dict)


def fit_searched(
    search: SettingsSearch[_Searched],
    arrays: Mapping[str, NDArray[Any]],
    task: FitTask,
    given: Mapping[str, Any],
    notes: Mapping[str, Any],
) -> None:
    """Write the `arrays`, the settings with the best score on excerpts of `task.train`, and their calibration.

    The settings in `given` are not searched. The search begins with the defaults, or with the settings of the general
    weights `task.start`; `task.validation` decides between the best settings. `notes` are added to the results on the
    card. Raises WeightsError if the recordings differ in grid, period or site or the general weights are damaged,
    ConfigurationError without torch.
    """
    arrays, name = {**arrays, "calibration": IDENTITY}, registered_name(search.tracker)
    start, ranges = _begin(search, name, task, given)
    card = card_for(name, task, {})
    searched = searched_excerpts(task.train, general=task.general)
    with TemporaryDirectory() as folder:
        draft: _Draft[_Searched] = _Draft(search.tracker, Path(folder) / f"{name}.toml", task)
        save_weights(draft.path, card, arrays)
        finalists, reached = search_settings(
            ranges, lambda tried: draft.score_of_each(search.during(tried), searched), start, task
        )
        if reached:
            card = card_for(name, task, finalists[0].model_dump(), notes)
            save_interrupted(task.out, card, arrays, f"{reached}, not calibrated")
            raise KeyboardInterrupt
        settings = _decided(search, draft, finalists, start, given)
        arrays["calibration"] = draft.calibration(settings, searched)
        save_weights(draft.path, card, arrays)
        results = {
            "train": draft.summaries(settings, searched),
            "validation": draft.summaries(settings, task.validation),
            **notes,
        }
    save_weights(task.out, card_for(name, task, settings.model_dump(), results), arrays)


def _begin(
    search: SettingsSearch[_Searched], name: str, task: FitTask, given: Mapping[str, Any]
) -> tuple[_Searched, dict[str, tuple[float, float]]]:
    """The settings that the search begins with, and the ranges that it searches. Raises WeightsError."""
    start = search.kind(**given)
    ranges = {key: bounds for key, bounds in search.ranges.items() if key not in given}
    if task.start is None:
        return start, ranges
    start = tuned_settings(search.kind, load_start(task.start, name), start)
    near = {key: _near(getattr(start, key), *bounds) for key, bounds in ranges.items() if key not in search.of_place}
    return start, ranges | near


def _near(value: float, low: float, high: float) -> tuple[float, float]:
    """The part of a range that is at most a factor NEAR from `value`, which may be outside of the range."""
    value = clipped(value, low, high)
    return max(low, value / NEAR), min(high, NEAR * value)


def _decided(
    search: SettingsSearch[_Searched],
    draft: _Draft[_Searched],
    finalists: list[_Searched],
    start: _Searched,
    given: Mapping[str, Any],
) -> _Searched:
    """The finalist with the best selection score on `task.validation`; the first one without validation.

    From general weights on, their settings `start` are a finalist too. At a site each finalist is also tried without
    the map of the place, which is not used if the best of these is better by MAP_WORTH.
    """
    task = draft.task
    if task.start is not None and start not in finalists:
        finalists = [*finalists, start]
    if len(finalists) == 1 or not task.validation:
        return finalists[0]
    settings, value = draft.best_of(finalists)
    if task.start is not None and not task.general and not search.without_map.keys() <= given.keys():
        bare = [search.kind(**{**one.model_dump(), **search.without_map}) for one in finalists]
        best_bare, bare_value = draft.best_of(bare)
        if bare_value >= value + MAP_WORTH:
            task.report(
                f"without the map of the place the {SELECTION_SCORE} on validation is {bare_value:.5f}: the map is not"
                " used"
            )
            return best_bare
    return settings


@dataclass(frozen=True, slots=True)
class _Draft(Generic[_Searched]):
    """The weights in training: `tracker` runs with the card at `path` and is scored by the objective of `task`."""

    tracker: type[CalibratedTracker]
    path: Path
    task: FitTask

    def running(self, settings: _Searched, source: FrameSource) -> CalibratedTracker:
        return self.tracker(stream_of(source, self.path), settings)

    def scored(self, settings: _Searched, source: FrameSource) -> StretchScore:
        steps = step_of(source, max(SELECTION_HORIZONS_S))
        return self.task.objective(self.running(settings, source), source, steps)

    def score_of_each(self, settings: _Searched, sources: Sequence[FrameSource]) -> Iterator[float]:
        """The selection score on each source in turn; NaN if it is undefined."""
        scores = (selection_scores(self.scored(settings, source), source) for source in sources)
        return (mean_of_defined(of_one.values()) for of_one in scores)

    def best_of(self, finalists: list[_Searched]) -> tuple[_Searched, float]:
        """The settings with the best selection score on `task.validation`, and that score."""
        values = []
        with self.task.progress.stage("finalist", len(finalists)) as stage:
            for settings in finalists:
                values.append(mean_of_defined(self.score_of_each(settings, self.task.validation)))
                stage.advance(f"{SELECTION_SCORE} on validation {values[-1]:.5f}")
        found = int(np.argmax(values))  # 0 if none is defined: nothing moves in the validation recordings
        self.task.report(
            f"number {found + 1} of the {len(finalists)} best is chosen: {SELECTION_SCORE} on validation"
            f" {values[found]:.5f}"
        )
        return finalists[found], values[found]

    def summaries(self, settings: _Searched, sources: Sequence[FrameSource]) -> list[dict[str, Any]]:
        return [stretch_summary(self.scored(settings, source), source) for source in sources]

    def calibration(self, settings: _Searched, sources: Sequence[FrameSource]) -> NDArray[np.float32]:
        last = max(SELECTION_HORIZONS_S)
        parameters = fit_calibration(
            (self.running(settings, source), list(source), step_of(source, last)) for source in sources
        )
        for ahead_s, of_groups in zip(FITTED_S, parameters.tolist(), strict=True):
            for group, (a, b, c) in zip(("cells seen recently", "other cells"), of_groups, strict=True):
                formula = f"logit = {c:.3f} + {a:.3f} ln p - {b:.3f} ln(1 - p)"
                self.task.report(f"calibration {ahead_s:g} s ahead, {group}: {formula}")
        return parameters


def stretch_summary(score: StretchScore, source: FrameSource) -> dict[str, Any]:
    """The scores of one stretch for a card, without undefined ones."""
    columns = {"dynamic_log_loss": score.log_loss["dynamic"], **selection_curves(score)}
    at = {f"{horizon:g}s": step_of(source, horizon) for horizon in SELECTION_HORIZONS_S}
    return {"stretch": source.name} | {
        name: {horizon: round(float(values[step]), 4) for horizon, step in at.items() if math.isfinite(values[step])}
        for name, values in columns.items()
    }


MAX_LOG_BYTES = 1 << 24
FINALISTS = 5
"""Number of the best settings of a search between which the validation recordings decide."""
FEWEST_EXCERPTS, WORSE_P = 6, 0.02
"""After at least this many excerpts settings are pruned if a Wilcoxon signed-rank test against the best ones so far, on
the same excerpts, has a lower p-value. Excerpts differ much more than settings do."""


class SearchLog:
    """The scores of the settings that a search tried, in a file.

    A search of the same seed tries the same settings again, so that it continues from this file. The storages of
    Optuna do not hold the state of its sampler: a search that continued from one would try other settings.
    """

    def __init__(self, task: FitTask, ranges: Mapping[str, tuple[float, float]], start: Settings) -> None:
        """The scores in `task.log_dir` of an interrupted search with the same arguments; without one there are none."""
        self._path = task.log_dir / SEARCH_FILE
        search = {
            "objective": SELECTION_SCORE,
            "ranges": ranges,
            "start": start.model_dump(mode="json"),
            "seed": task.seed,
            "train": [[source.name, source.sha256, len(source)] for source in task.train],
        }
        self._search = json.loads(json.dumps(search))
        self._scores: dict[str, list[float]] = {}
        with suppress(FileNotFoundError, ValueError, AttributeError, KeyError, TypeError):
            found = parse_json(read_bounded(self._path, MAX_LOG_BYTES, RecordingError))
            if found.get("search") == self._search:
                self._scores = {str(key): [float(score) for score in found["scores"][key]] for key in found["scores"]}

    def of(self, tried: Mapping[str, float]) -> list[float]:
        """The scores of the settings `tried`; empty if they are not in the file."""
        return self._scores.get(json.dumps(tried, sort_keys=True), [])

    def add(self, tried: Mapping[str, float], scores: list[float]) -> None:
        """Write the scores of the settings `tried`. Raises OSError."""
        if scores != self.of(tried):
            self._scores[json.dumps(tried, sort_keys=True)] = scores
            self._path.parent.mkdir(parents=True, exist_ok=True)
            write_text(self._path, json.dumps({"search": self._search, "scores": self._scores}))


def search_settings(
    ranges: Mapping[str, tuple[float, float]],
    score_of_each: Callable[[_Searched], Iterable[float]],
    start: _Searched,
    task: FitTask,
) -> tuple[list[_Searched], str]:
    """The FINALISTS best settings of SEARCH_ITERATIONS of a Bayesian search, the best first.

    It maximises the mean of `score_of_each` excerpt. A Gaussian process predicts it, and the settings with the greatest
    logarithm of the expected improvement are tried next (Jones, Schonlau and Welch, 1998; Ament et al., 2023); the
    first tries are `start` and random ones. Each key of `ranges` is searched log-uniformly from low to high; the other
    settings are taken from `start`, which is the only result if nothing is searched. Settings that are significantly
    worse than the best ones so far are not scored on all excerpts. The same seed gives the same search. The scores of
    each iteration are written to `task.log_dir`: an interrupted search with the same `task.train` continues there.

    After an interrupt the result is the best one so far, and the last step that was reached, which else is "". Raises
    KeyboardInterrupt before the first iteration is done, RecordingError if the score is undefined, ConfigurationError
    without torch.
    """
    if not ranges:
        return [start], ""
    log = SearchLog(task, ranges, start)

    def with_tried(values: Mapping[str, float]) -> tuple[dict[str, float], _Searched]:
        tried = {key: float(f"{value:.3g}") for key, value in values.items()}  # as rounded as on the card
        return tried, type(start)(**{**start.model_dump(), **tried})

    def value_of(trial: optuna.Trial) -> float:
        tried, settings = with_tried({key: trial.suggest_float(key, *ranges[key], log=True) for key in ranges})
        scores, value = _scored(trial, log.of(tried) or score_of_each(settings))
        log.add(tried, scores)
        if not math.isfinite(value):
            raise RecordingError(
                f"{SELECTION_SCORE} is not defined on the training recordings: no visible cell was occupied by a moving"
                " object; use a longer stretch"
            )
        return value

    study = _study({key: clipped(getattr(start, key), *ranges[key]) for key in ranges}, task.seed)
    try:
        with task.progress.stage("search iteration", SEARCH_ITERATIONS) as stage, warnings.catch_warnings():
            warnings.filterwarnings("ignore", "WilcoxonPruner finds steps")  # excerpts on which one is undefined
            study.optimize(
                value_of,
                n_trials=SEARCH_ITERATIONS,
                callbacks=[lambda study, _: stage.advance(f"best {SELECTION_SCORE} {study.best_value:.5f}")],
            )
    except KeyboardInterrupt:
        if not stage.done:
            raise
        return [with_tried(study.best_params)[1]], f"search iteration {stage.done} of {SEARCH_ITERATIONS}"
    task.report(f"best of {SEARCH_ITERATIONS} search iterations: {SELECTION_SCORE} {study.best_value:.5f}")
    best = sorted(study.get_trials(deepcopy=False), key=lambda trial: -trial.values[0])[:FINALISTS]
    return [with_tried(trial.params)[1] for trial in best], ""


def _study(start: dict[str, float], seed: int) -> optuna.Study:
    """A study that tries `start` first. Raises ConfigurationError without torch."""
    if find_spec("torch") is None:
        raise ConfigurationError("the search of settings needs torch: pip install 'gridtrack[deep]'")
    import optuna

    optuna.logging.set_verbosity(optuna.logging.ERROR)  # exceptions of the target are raised, not logged as well
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        sampler = optuna.samplers.GPSampler(seed=seed)
        pruner = optuna.pruners.WilcoxonPruner(p_threshold=WORSE_P, n_startup_steps=FEWEST_EXCERPTS)
    study = optuna.create_study(direction="maximize", sampler=sampler, pruner=pruner)
    study.enqueue_trial(start)
    return study


def _scored(trial: optuna.Trial, scores: Iterable[float]) -> tuple[list[float], float]:
    """The scores of the settings of a trial, up to the one after which they are pruned, and their mean.

    Undefined scores do not count; without any score the mean is NaN. Of pruned settings it is the mean of the best ones
    plus the mean difference from them: the mean of the first excerpts alone says little, they may be easy.
    """
    scored: list[float] = []
    for number, score in enumerate(scores):
        scored.append(score)
        if math.isfinite(score):
            trial.report(score, number)
            if trial.should_prune():
                best = trial.study.best_trial.intermediate_values
                differences = [scored[n] - best[n] for n in best if n < len(scored) and math.isfinite(scored[n])]
                return scored, float(np.mean([*best.values()]) + np.mean(differences))
    return scored, mean_of_defined(scored)


def clipped(value: float, low: float, high: float) -> float:
    """The value within a range; a setting of general weights may lie outside the range of a search."""
    return min(max(value, low), high)
