"""A seeded search of settings with Optuna, which an interrupted training continues."""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

import numpy as np

from gridtrack.common.config import Settings
from gridtrack.common.errors import ConfigurationError, RecordingError
from gridtrack.common.files import read_bounded, write_text
from gridtrack.common.untrusted import parse_json
from gridtrack.trackers.contract import FitTask
from gridtrack.trackers.training.excerpts import mean_of_defined

if TYPE_CHECKING:
    import optuna

SEARCH_FILE = "search.json"
MAX_LOG_BYTES = 1 << 24
FINALISTS = 5
"""Number of the best settings of a search between which the validation recordings decide."""
FEWEST_EXCERPTS, WORSE_P = 6, 0.02
"""After at least this many excerpts settings are pruned if a Wilcoxon signed-rank test against the best ones so far, on
the same excerpts, has a lower p-value. Excerpts differ much more than settings do."""

_Tuned = TypeVar("_Tuned", bound=Settings)


class SearchTarget(NamedTuple, Generic[_Tuned]):
    """A search maximises the mean of the scores `of` settings, one per excerpt; its `name` for reports."""

    name: str
    of: Callable[[_Tuned], Iterable[float]]


class SearchInterrupted(KeyboardInterrupt):
    """A search was interrupted: its `best` settings so far, and the last step that it `reached`."""

    def __init__(self, best: Any, reached: str) -> None:
        super().__init__(reached)
        self.best, self.reached = best, reached


class SearchLog:
    """The scores of the settings that a search tried, in a file.

    A search of the same seed tries the same settings again, so that it continues from this file. The storages of
    Optuna do not hold the state of its sampler: a search that continued from one would try other settings.
    """

    def __init__(self, path: Path, search: Mapping[str, Any]) -> None:
        """`search` describes the search; the scores of another one are ignored."""
        self._path, self._search = path, json.loads(json.dumps(search))
        self._scores: dict[str, list[float]] = {}
        with suppress(FileNotFoundError, ValueError, AttributeError, KeyError, TypeError):
            found = parse_json(read_bounded(path, MAX_LOG_BYTES, RecordingError))
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


def delete_search_log(task: FitTask) -> None:
    """Delete the scores of a search after its result is written: a search with other code must not use them."""
    (task.log_dir / SEARCH_FILE).unlink(missing_ok=True)


def search_settings(
    ranges: Mapping[str, tuple[float, float]],
    target: SearchTarget[_Tuned],
    start: _Tuned,
    iterations: int,
    task: FitTask,
) -> list[_Tuned]:
    """The FINALISTS best settings of `iterations` of a Bayesian search, the best first.

    A Gaussian process predicts the target, and the settings with the greatest logarithm of the expected improvement
    are tried next (Jones, Schonlau and Welch, 1998; Ament et al., 2023); the first tries are `start` and random ones.
    Each key of `ranges` is searched log-uniformly from low to high; the other settings are taken from `start`, which is
    the only result if nothing is searched. Settings that are significantly worse than the best ones so far are not
    scored on all excerpts. The same seed gives the same search. The scores of each iteration are written to
    `task.log_dir`: an interrupted search with the same `task.train` continues there, until `delete_search_log`.

    Raises RecordingError if the target is undefined, SearchInterrupted if it is interrupted after an iteration,
    ConfigurationError without torch.
    """
    if not ranges:
        return [start]
    log = _log_of(ranges, target, start, task)

    def with_tried(values: Mapping[str, float]) -> tuple[dict[str, float], _Tuned]:
        tried = {key: three_digits(value) for key, value in values.items()}
        return tried, type(start)(**{**start.model_dump(), **tried})

    def value_of(trial: optuna.Trial) -> float:
        tried, settings = with_tried({key: trial.suggest_float(key, *ranges[key], log=True) for key in ranges})
        scores, value = _scored(trial, log.of(tried) or target.of(settings))
        log.add(tried, scores)
        if not math.isfinite(value):
            raise RecordingError(
                f"{target.name} is not defined on the training recordings: no visible cell was occupied by a moving"
                " object; use a longer stretch"
            )
        return value

    study = _study({key: clipped(getattr(start, key), *ranges[key]) for key in ranges}, task.seed)
    try:
        with task.progress.stage("search iteration", iterations) as stage, warnings.catch_warnings():
            warnings.filterwarnings("ignore", "WilcoxonPruner finds steps")  # excerpts on which one is undefined
            study.optimize(
                value_of,
                n_trials=iterations,
                callbacks=[lambda study, _: stage.advance(f"best {target.name} {study.best_value:.5f}")],
            )
    except KeyboardInterrupt:
        if not stage.done:
            raise
        reached = f"search iteration {stage.done} of {iterations}"
        raise SearchInterrupted(with_tried(study.best_params)[1], reached) from None
    task.report(f"best of {iterations} search iterations: {target.name} {study.best_value:.5f}")
    best = sorted(study.get_trials(deepcopy=False), key=lambda trial: -trial.values[0])[:FINALISTS]
    return [with_tried(trial.params)[1] for trial in best]


def _log_of(
    ranges: Mapping[str, tuple[float, float]], target: SearchTarget[_Tuned], start: _Tuned, task: FitTask
) -> SearchLog:
    """The scores of an interrupted search with the same task, or a new log."""
    identity = {
        "objective": target.name,
        "ranges": {key: list(bounds) for key, bounds in ranges.items()},
        "start": start.model_dump(mode="json"),
        "seed": task.seed,
        "train": [[source.name, source.sha256, len(source)] for source in task.train],
    }
    return SearchLog(task.log_dir / SEARCH_FILE, identity)


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


def three_digits(value: float) -> float:
    """Three significant digits: the search evaluates the rounded values that the card has."""
    return float(f"{value:.3g}")
