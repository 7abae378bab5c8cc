"""Tuning a tracker's few parameters: a seeded search for the least log loss of moving cells, and what a card says.

The search minimises log loss, a proper score: it sees a forecast grow rightly unsure of where a walker will be, which
the F1 at the best threshold of a short stretch does not tell from chance.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any, TypeVar

import numpy as np
import optuna

from gridtrack.common.config import Settings
from gridtrack.common.grid import GridFrame, GridSpec, LabelledFrame
from gridtrack.trackers.contract import FrameSource, StretchScore

HORIZONS_S = (0.2, 0.5, 1.0, 2.0)
"""What is tuned for: the mean over these of the log loss on moving cells."""
REPORT_EVERY = 10

Tuned = TypeVar("Tuned", bound=Settings)


@dataclass(slots=True)
class HeldSource:
    """The beginning of another source, its frames made once and held in memory: a search streams it many times."""

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
        frames = list(islice(source, max(1, round(seconds / source.period_s))))
        return cls(source.name, source.sha256, source.grid, source.period_s, source.site, source.classes, tuple(frames))

    def __iter__(self) -> Iterator[GridFrame]:
        return iter(self.frames)

    def __len__(self) -> int:
        return len(self.frames)

    def labelled(self) -> Iterator[LabelledFrame]:
        """No labels are held: what is tuned here is occupancy."""
        raise NotImplementedError("classes are not learned from held frames")


def search(
    kind: type[Tuned],
    ranges: Mapping[str, tuple[float, float]],
    loss: Callable[[Tuned], float],
    given: Mapping[str, Any],
    trials: int,
    seed: int,
    report: Callable[[str], None],
) -> Tuned:
    """The settings of least `loss` in `trials` trials of a tree-structured Parzen estimator, the defaults first.

    Each key of `ranges` is searched from low to high, log-uniformly; settings in `given` are kept. The same seed makes
    the same search.
    """
    tuned = {key: bounds for key, bounds in ranges.items() if key not in given}

    def objective(trial: optuna.Trial) -> float:
        return loss(kind(**given, **{key: _suggested(trial, key, *tuned[key]) for key in tuned}))

    def tell(study: optuna.Study, trial: optuna.trial.FrozenTrial) -> None:
        if trial.number % REPORT_EVERY == 0:
            report(f"trial {trial.number + 1} of {trials}, log loss {study.best_value:.5f}")

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=seed, multivariate=True))
    defaults = kind()
    study.enqueue_trial({key: getattr(defaults, key) for key in tuned})
    study.optimize(objective, n_trials=trials, callbacks=[tell])
    return kind(**given, **{key: three_digits(value) for key, value in study.best_params.items()})


def furthest_step(source: FrameSource) -> int:
    """The last step that is tuned for."""
    return step_of(source, max(HORIZONS_S))


def moving_loss(score: StretchScore, source: FrameSource) -> float:
    """Mean log loss on moving cells over HORIZONS_S."""
    return float(np.mean([score.log_loss["moving"][step_of(source, horizon)] for horizon in HORIZONS_S]))


def summary(score: StretchScore, source: FrameSource) -> dict[str, Any]:
    """What a card says of one stretch."""
    columns = {
        "moving_log_loss": score.log_loss["moving"],
        "visible_f1": score.f1["visible"],
        "moving_f1": score.f1["moving"],
    }
    at = {f"{horizon:g}s": step_of(source, horizon) for horizon in HORIZONS_S}
    return {"stretch": source.name} | {
        name: {horizon: round(float(values[step]), 4) for horizon, step in at.items()}
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
