"""Tuning of the settings of a tracker: a seeded search, frames cached in memory, scores for the card."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any, Generic, Literal, NamedTuple, TypeVar

import optuna

from gridtrack.common.config import Settings
from gridtrack.common.errors import RecordingError
from gridtrack.common.grid import GridFrame, GridSpec, LabelledFrame
from gridtrack.trackers.contract import FitOutput, FrameSource, StretchScore

REPORT_EVERY = 10
"""Search iterations between two progress reports."""

_Tuned = TypeVar("_Tuned", bound=Settings)


@dataclass(slots=True)
class CachedSource:
    """A part of another source, its frames cached in memory: a search streams it many times."""

    name: str
    sha256: str
    grid: GridSpec
    period_s: float
    site: str
    classes: tuple[str, ...]
    frames: Sequence[GridFrame]

    @classmethod
    def beginning(cls, source: FrameSource, seconds: float) -> CachedSource:
        """The first `seconds` of `source`, or all of a shorter one."""
        return cls._of(source, source.name, 0, max(1, round(seconds / source.period_s)))

    @classmethod
    def excerpt(cls, source: FrameSource, first: int, count: int) -> CachedSource:
        """The `count` frames of `source` from number `first` on, named by their time range."""
        name = f"{source.name}, {count * source.period_s:g} s from {first * source.period_s:g} s on"
        return cls._of(source, name, first, count)

    @classmethod
    def _of(cls, source: FrameSource, name: str, first: int, count: int) -> CachedSource:
        frames = tuple(islice(source, first, first + count))
        return cls(name, source.sha256, source.grid, source.period_s, source.site, source.classes, frames)

    def __iter__(self) -> Iterator[GridFrame]:
        return iter(self.frames)

    def __len__(self) -> int:
        return len(self.frames)

    def labelled(self) -> Iterator[LabelledFrame]:
        """Not available: only occupancy is tuned on cached frames."""
        raise NotImplementedError("classes are not trained on cached frames")


class Objective(NamedTuple, Generic[_Tuned]):
    """The objective of a search: its `name` in reports, its direction, and its value `of` settings."""

    name: str
    better: Literal["minimize", "maximize"]
    of: Callable[[_Tuned], float]


def search_settings(
    kind: type[_Tuned],
    ranges: Mapping[str, tuple[float, float]],
    objective: Objective[_Tuned],
    starts: Sequence[_Tuned],
    given: Mapping[str, Any],
    iterations: int,
    out: FitOutput,
) -> _Tuned:
    """The best settings of `iterations` of a tree-structured Parzen estimator, which starts with `starts`.

    Each key of `ranges` is searched log-uniformly from low to high. Settings in `given` are not searched; if no key
    remains they are returned. The same seed gives the same search. An interrupted search reports its best settings.
    Raises RecordingError where the objective is undefined.
    """
    tuned = {key: bounds for key, bounds in ranges.items() if key not in given}
    if not tuned:
        return kind(**given)

    def value_of(trial: optuna.Trial) -> float:
        value = objective.of(kind(**given, **{key: _suggested(trial, key, *tuned[key]) for key in tuned}))
        if not math.isfinite(value):
            raise RecordingError(
                f"{objective.name} is not defined on the training recordings: no visible cell was occupied by a moving"
                " object; use a longer stretch"
            )
        return value

    def report(study: optuna.Study, trial: optuna.trial.FrozenTrial) -> None:
        if trial.number % REPORT_EVERY == 0:
            out.report(f"search iteration {trial.number + 1} of {iterations}, {objective.name} {study.best_value:.5f}")

    optuna.logging.set_verbosity(optuna.logging.ERROR)  # exceptions of the objective are raised, not logged as well
    sampler = optuna.samplers.TPESampler(seed=out.seed, multivariate=True)
    study = optuna.create_study(direction=objective.better, sampler=sampler)
    for start in starts:
        study.enqueue_trial({key: getattr(start, key) for key in tuned})
    try:
        study.optimize(value_of, n_trials=iterations, callbacks=[report])
    except KeyboardInterrupt:
        _report_best(study, objective.name, out)
        raise
    return kind(**given, **_best(study))


def _best(study: optuna.Study) -> dict[str, float]:
    return {key: three_digits(value) for key, value in study.best_params.items()}


def _report_best(study: optuna.Study, name: str, out: FitOutput) -> None:
    """Report the best settings of an interrupted search, in the form of options."""
    done = study.get_trials(states=[optuna.trial.TrialState.COMPLETE])
    if done:
        found = ",".join(f"{key}={value:g}" for key, value in _best(study).items())
        out.report(f"interrupted; best of {len(done)} search iterations, {name} {study.best_value:.5f}: {found}")


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
    return max(1, round(horizon_s / source.period_s))


def three_digits(value: float) -> float:
    """Three significant digits: the search evaluates the rounded values that the card has."""
    return float(f"{value:.3g}")


def _suggested(trial: optuna.Trial, key: str, low: float, high: float) -> float:
    return three_digits(trial.suggest_float(key, low, high, log=True))
