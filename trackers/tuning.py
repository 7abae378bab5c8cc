"""Tuning of the settings of a tracker: a seeded search, frames cached in memory, scores for the card."""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

import optuna

from gridtrack.common.config import Settings
from gridtrack.common.errors import ConfigurationError, RecordingError
from gridtrack.common.files import read_bounded, write_text
from gridtrack.common.grid import nearest_step
from gridtrack.common.untrusted import parse_json
from gridtrack.trackers.contract import FitOutput, FrameSource, StretchScore
from gridtrack.trackers.racing import Race

SEARCH_FILE = "search.json"
MAX_LOG_BYTES = 1 << 24
FINALISTS = 5
"""Number of the best settings of a search between which the validation recordings decide."""

_Tuned = TypeVar("_Tuned", bound=Settings)


class Objective(NamedTuple, Generic[_Tuned]):
    """What a search maximises: the mean of the scores `of` settings, one for each excerpt; its `name` in reports."""

    name: str
    of: Callable[[_Tuned], Iterable[float]]


class SearchInterrupted(KeyboardInterrupt):
    """A search was interrupted: its `best` settings so far, and how far it had `reached`."""

    def __init__(self, best: Any, reached: str) -> None:
        super().__init__(reached)
        self.best, self.reached = best, reached


class SearchLog:
    """The scores of the iterations of a search, in a file: a search of the same seed tries the same settings again."""

    def __init__(self, path: Path, searched: Mapping[str, Any]) -> None:
        """`searched` describes the search: scores of another one are not used."""
        self._path, self._searched = path, json.loads(json.dumps(searched))
        self._scores: dict[str, list[float]] = {}
        with suppress(FileNotFoundError, ValueError, AttributeError, KeyError, TypeError):
            found = parse_json(read_bounded(path, MAX_LOG_BYTES, RecordingError))
            if found.get("search") == self._searched:
                self._scores = {str(key): [float(score) for score in found["scores"][key]] for key in found["scores"]}

    def scores(self, tried: Mapping[str, float], evaluate: Callable[[], list[float]]) -> list[float]:
        """The scores of the settings `tried`: those of the file, else evaluated and written. Raises OSError."""
        key = json.dumps(tried, sort_keys=True)
        if key not in self._scores:
            self._scores[key] = evaluate()
            self._path.parent.mkdir(parents=True, exist_ok=True)
            write_text(self._path, json.dumps({"search": self._searched, "scores": self._scores}))
        return self._scores[key]


def delete_search_log(out: FitOutput) -> None:
    """Delete the scores of a search whose result is written: a search with other code must not use them."""
    (out.log_dir / SEARCH_FILE).unlink(missing_ok=True)


def search_settings(
    kind: type[_Tuned],
    ranges: Mapping[str, tuple[float, float]],
    objective: Objective[_Tuned],
    start: _Tuned,
    iterations: int,
    train: Sequence[FrameSource],
    out: FitOutput,
) -> list[_Tuned]:
    """The FINALISTS best settings of `iterations` of a Bayesian search, the best first.

    A Gaussian process predicts the objective, and the settings with the greatest logarithm of the expected improvement
    are tried next (Jones, Schonlau and Welch, 1998; Ament et al., 2023); the first tries are `start` and random ones.
    Each key of `ranges` is searched log-uniformly from low to high; the other settings are those of `start`, which is
    the only result where nothing is searched. Settings that lose a race against the best ones so far are not scored on
    all excerpts. The same seed gives the same search. The scores of each iteration are written to `out.log_dir`: an
    interrupted search with the same `train` continues there, until `delete_search_log`.
    Raises RecordingError where the objective is undefined, SearchInterrupted where it is interrupted after an
    iteration, ConfigurationError without torch.
    """
    if not ranges:
        return [start]
    searched = {
        "objective": objective.name,
        "ranges": {key: list(bounds) for key, bounds in ranges.items()},
        "start": start.model_dump(mode="json"),
        "seed": out.seed,
        "train": [[source.name, source.sha256, len(source)] for source in train],
    }
    known, race = SearchLog(out.log_dir / SEARCH_FILE, searched), Race()

    def with_tried(tried: Mapping[str, float]) -> _Tuned:
        return kind(**{**start.model_dump(), **tried})

    def value_of(trial: optuna.Trial) -> float:
        tried = {key: _suggested(trial, key, *ranges[key]) for key in ranges}
        scores = known.scores(tried, lambda: race.run(objective.of(with_tried(tried))))
        return _defined(objective, race.mean(scores))

    study = _study({key: clipped(getattr(start, key), *ranges[key]) for key in ranges}, out.seed)
    try:
        with out.progress.stage("search iteration", iterations) as stage:
            study.optimize(
                value_of,
                n_trials=iterations,
                callbacks=[lambda study, _: stage.advance(f"best {objective.name} {study.best_value:.5f}")],
            )
    except KeyboardInterrupt:
        if not stage.done:
            raise
        raise SearchInterrupted(
            with_tried(_tried(study.best_trial)), f"search iteration {stage.done} of {iterations}"
        ) from None
    out.report(f"best of {iterations} search iterations: {objective.name} {study.best_value:.5f}")
    best = sorted(study.get_trials(deepcopy=False), key=lambda trial: -trial.values[0])[:FINALISTS]
    return [with_tried(_tried(trial)) for trial in best]


def _study(start: dict[str, float], seed: int) -> optuna.Study:
    """A study that tries `start` first. Raises ConfigurationError without torch."""
    if find_spec("torch") is None:
        raise ConfigurationError("the search of settings needs torch: pip install 'gridtrack[deep]'")
    optuna.logging.set_verbosity(optuna.logging.ERROR)  # exceptions of the objective are raised, not logged as well
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        sampler = optuna.samplers.GPSampler(seed=seed)
    study = optuna.create_study(direction="maximize", sampler=sampler)
    study.enqueue_trial(start)
    return study


def clipped(value: float, low: float, high: float) -> float:
    """General weights whose training was given a setting may have it outside its range."""
    return min(max(value, low), high)


def _defined(objective: Objective[Any], value: float) -> float:
    """The value of the objective. Raises RecordingError where it is undefined."""
    if not math.isfinite(value):
        raise RecordingError(
            f"{objective.name} is not defined on the training recordings: no visible cell was occupied by a moving"
            " object; use a longer stretch"
        )
    return value


def _tried(trial: optuna.trial.FrozenTrial) -> dict[str, float]:
    return {key: three_digits(value) for key, value in trial.params.items()}


def stretch_summary(score: StretchScore, source: FrameSource, horizons_s: Sequence[float]) -> dict[str, Any]:
    """The scores of one stretch for a card, without undefined ones."""
    columns = {
        "dynamic_log_loss": score.log_loss["dynamic"],
        "visible_f1": score.f1["visible"],
        "dynamic_f1": score.f1["dynamic"],
    }
    at = {f"{horizon:g}s": step_of(source, horizon) for horizon in horizons_s}
    return {"stretch": source.name} | {
        name: {horizon: round(float(values[step]), 4) for horizon, step in at.items() if math.isfinite(values[step])}
        for name, values in columns.items()
    }


def step_of(source: FrameSource, horizon_s: float) -> int:
    """The step nearest to a horizon, at least 1."""
    return max(1, nearest_step(horizon_s, source.period_s))


def three_digits(value: float) -> float:
    """Three significant digits: the search evaluates the rounded values that the card has."""
    return float(f"{value:.3g}")


def _suggested(trial: optuna.Trial, key: str, low: float, high: float) -> float:
    return three_digits(trial.suggest_float(key, low, high, log=True))
