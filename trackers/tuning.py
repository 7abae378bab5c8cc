"""Tuning a tracker's few parameters: a seeded search, on frames held in memory, and what a card says of the result."""

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

Tuned = TypeVar("Tuned", bound=Settings)


@dataclass(slots=True)
class HeldSource:
    """A part of another source, its frames made once and held in memory: a search streams it many times."""

    name: str
    sha256: str
    grid: GridSpec
    period_s: float
    site: str
    classes: tuple[str, ...]
    frames: Sequence[GridFrame]

    @classmethod
    def beginning(cls, source: FrameSource, seconds: float) -> HeldSource:
        """The first `seconds` of `source`, or all of it where it is shorter."""
        return cls._of(source, source.name, 0, max(1, round(seconds / source.period_s)))

    @classmethod
    def excerpt(cls, source: FrameSource, first: int, count: int) -> HeldSource:
        """The `count` frames of `source` from the `first` on, named by the seconds that they are."""
        name = f"{source.name}, {count * source.period_s:g} s from {first * source.period_s:g} s on"
        return cls._of(source, name, first, count)

    @classmethod
    def _of(cls, source: FrameSource, name: str, first: int, count: int) -> HeldSource:
        frames = tuple(islice(source, first, first + count))
        return cls(name, source.sha256, source.grid, source.period_s, source.site, source.classes, frames)

    def __iter__(self) -> Iterator[GridFrame]:
        return iter(self.frames)

    def __len__(self) -> int:
        return len(self.frames)

    def labelled(self) -> Iterator[LabelledFrame]:
        """No labels are held: what is tuned here is occupancy."""
        raise NotImplementedError("classes are not learned from held frames")


class Measure(NamedTuple, Generic[Tuned]):
    """What settings are chosen by: its `name` in reports, which way is better, and what it is `of` settings."""

    name: str
    better: Literal["minimize", "maximize"]
    of: Callable[[Tuned], float]


def search(
    kind: type[Tuned],
    ranges: Mapping[str, tuple[float, float]],
    measure: Measure[Tuned],
    starts: Sequence[Tuned],
    given: Mapping[str, Any],
    trials: int,
    out: FitOutput,
) -> Tuned:
    """The settings best by `measure` in `trials` trials of a tree-structured Parzen estimator, the `starts` first.

    Each key of `ranges` is searched from low to high, log-uniformly; settings in `given` are kept, and where they are
    all that is searched they are the answer. The same seed makes the same search. One that is interrupted tells the
    best so far. Raises RecordingError where the measure is not defined.
    """
    tuned = {key: bounds for key, bounds in ranges.items() if key not in given}
    if not tuned:
        return kind(**given)

    def objective(trial: optuna.Trial) -> float:
        value = measure.of(kind(**given, **{key: _suggested(trial, key, *tuned[key]) for key in tuned}))
        if not math.isfinite(value):
            raise RecordingError(
                f"{measure.name} is not defined on what is trained on: nothing that moves came into a cell that was in "
                "view; name a longer stretch"
            )
        return value

    def tell(study: optuna.Study, trial: optuna.trial.FrozenTrial) -> None:
        if trial.number % REPORT_EVERY == 0:
            out.report(f"trial {trial.number + 1} of {trials}, {measure.name} {study.best_value:.5f}")

    optuna.logging.set_verbosity(optuna.logging.ERROR)  # what an objective raises is raised, and need not be logged too
    sampler = optuna.samplers.TPESampler(seed=out.seed, multivariate=True)
    study = optuna.create_study(direction=measure.better, sampler=sampler)
    for start in starts:
        study.enqueue_trial({key: getattr(start, key) for key in tuned})
    try:
        study.optimize(objective, n_trials=trials, callbacks=[tell])
    except KeyboardInterrupt:
        _tell_best(study, measure.name, out)
        raise
    return kind(**given, **_best(study))


def _best(study: optuna.Study) -> dict[str, float]:
    return {key: three_digits(value) for key, value in study.best_params.items()}


def _tell_best(study: optuna.Study, name: str, out: FitOutput) -> None:
    """Report what an interrupted search has found, as options with which another needs no search."""
    done = study.get_trials(states=[optuna.trial.TrialState.COMPLETE])
    if done:
        found = ",".join(f"{key}={value:g}" for key, value in _best(study).items())
        out.report(f"interrupted; best of {len(done)} trials, {name} {study.best_value:.5f}: {found}")


def summary(score: StretchScore, source: FrameSource, horizons_s: Sequence[float]) -> dict[str, Any]:
    """What a card says of one stretch, as far as it is defined there."""
    columns = {
        "moving_log_loss": score.log_loss["moving"],
        "visible_f1": score.f1["visible"],
        "moving_f1": score.f1["moving"],
    }
    at = {f"{horizon:g}s": step_of(source, horizon) for horizon in horizons_s}
    return {"stretch": source.name} | {
        name: {horizon: round(float(values[step]), 4) for horizon, step in at.items() if math.isfinite(values[step])}
        for name, values in columns.items()
    }


def step_of(source: FrameSource, horizon_s: float) -> int:
    """The step nearest to a horizon."""
    return max(1, round(horizon_s / source.period_s))


def three_digits(value: float) -> float:
    """Three significant digits: a card is read by people, and the search must try what the card will say."""
    return float(f"{value:.3g}")


def _suggested(trial: optuna.Trial, key: str, low: float, high: float) -> float:
    return three_digits(trial.suggest_float(key, low, high, log=True))
