"""Training of a tracker by a search of its settings: the same search and calibration for every such tracker.

The caller counts the arrays of the site. Then the settings with the best mean F1 on excerpts of the training recordings
are searched, the validation recordings decide between the best of them, and the forecast is calibrated on the same
excerpts. A training that starts from general weights searches near their settings, because a stretch of a minute has
too little motion to find better ones from scratch. It searches the settings that weigh the map of the place against the
stream in their whole range, because general weights have no map. The search runs on the frames that the map was made
of, on which it is always right, so the validation recordings decide whether it does harm: on the map of a short
training everything that stood all the time, such as a queue of cars, is a wall.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.config import Settings
from gridtrack.common.grid import nearest_step
from gridtrack.trackers.contract import FitTask, FrameSource, StretchScore, stream_of
from gridtrack.trackers.registry import registered_name
from gridtrack.trackers.training.calibration import IDENTITY, CalibratedTracker, fit_calibration
from gridtrack.trackers.training.card import card_for
from gridtrack.trackers.training.excerpts import (
    SEARCHED_S,
    SELECTION_HORIZONS_S,
    SELECTION_STRATA,
    excerpts,
    excerpts_of_places,
    mean_of_defined,
)
from gridtrack.trackers.training.search import (
    SearchInterrupted,
    SearchTarget,
    clipped,
    delete_search_log,
    search_settings,
)
from gridtrack.trackers.training.weights import load_start, save_interrupted, save_weights, tuned_settings

SEARCH_ITERATIONS = 60
MAP_WORTH = 0.01
"""The map of the place is not used if mean F1 is better by this much without it; F1 does not count hidden cells, which
only the map knows."""
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
    """Write the `arrays`, the settings with the best F1 on excerpts of `task.train`, and their calibration.

    The settings in `given` are not searched. The search begins with the defaults, or with the settings of the general
    weights `task.start`; `task.validation` decides between the best settings. `notes` are added to the results on the
    card. Raises WeightsError if the recordings differ in grid, period or site or the general weights are damaged,
    ConfigurationError without torch.
    """
    arrays, name = {**arrays, "calibration": IDENTITY}, registered_name(search.tracker)
    start, ranges = _begin(search, name, task, given)
    card = card_for(name, task, {})
    searched = excerpts_of_places(task.train, SEARCHED_S) if task.general else excerpts(task.train)
    with TemporaryDirectory() as folder:
        draft: _Draft[_Searched] = _Draft(search.tracker, Path(folder) / f"{name}.toml", task)
        save_weights(draft.path, card, arrays)
        target = SearchTarget[_Searched]("mean F1", lambda tried: draft.f1_of_each(search.during(tried), searched))
        try:
            finalists = search_settings(ranges, target, start, SEARCH_ITERATIONS, task)
        except SearchInterrupted as stopped:
            card = card_for(name, task, stopped.best.model_dump(), notes)
            save_interrupted(task.out, card, arrays, f"{stopped.reached}, not calibrated")
            raise
        settings = _decided(search, draft, finalists, start, given)
        arrays["calibration"] = draft.calibration(settings, searched)
        save_weights(draft.path, card, arrays)
        results = {
            "train": draft.summaries(settings, searched),
            "validation": draft.summaries(settings, task.validation),
            **notes,
        }
    save_weights(task.out, card_for(name, task, settings.model_dump(), results), arrays)
    delete_search_log(task)


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
    """The finalist with the best F1 on `task.validation`; the first one without validation.

    From general weights on, their settings `start` are a finalist too. At a site each finalist is also tried without
    the map of the place, which is not used if the best of these is better by MAP_WORTH.
    """
    task = draft.task
    if task.start is not None and start not in finalists:
        finalists = [*finalists, start]
    if len(finalists) == 1 or not task.validation:
        return finalists[0]
    settings, f1 = draft.best_of(finalists)
    if task.start is not None and not task.general and not search.without_map.keys() <= given.keys():
        bare = [search.kind(**{**one.model_dump(), **search.without_map}) for one in finalists]
        best_bare, bare_f1 = draft.best_of(bare)
        if bare_f1 >= f1 + MAP_WORTH:
            task.report(f"without the map of the place mean F1 on validation is {bare_f1:.5f}: the map is not used")
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

    def f1_of_each(self, settings: _Searched, sources: Sequence[FrameSource]) -> Iterator[float]:
        """The mean F1 on each source in turn; NaN if it is undefined."""
        return (selection_f1(self.scored(settings, source), source) for source in sources)

    def best_of(self, finalists: list[_Searched]) -> tuple[_Searched, float]:
        """The settings with the best mean F1 on `task.validation`, and that F1."""
        values = []
        with self.task.progress.stage("finalist", len(finalists)) as stage:
            for settings in finalists:
                values.append(mean_of_defined(list(self.f1_of_each(settings, self.task.validation))))
                stage.advance(f"mean F1 on validation {values[-1]:.5f}")
        found = int(np.argmax(values))  # 0 if F1 is undefined: nothing moves in the validation recordings
        self.task.report(
            f"number {found + 1} of the {len(finalists)} best is chosen: mean F1 on validation {values[found]:.5f}"
        )
        return finalists[found], values[found]

    def summaries(self, settings: _Searched, sources: Sequence[FrameSource]) -> list[dict[str, Any]]:
        return [stretch_summary(self.scored(settings, source), source) for source in sources]

    def calibration(self, settings: _Searched, sources: Sequence[FrameSource]) -> NDArray[np.float32]:
        last = max(SELECTION_HORIZONS_S)
        parameters = fit_calibration(
            (self.running(settings, source), list(source), step_of(source, last)) for source in sources
        )
        for group, (a, b, c) in zip(("cells seen recently", "other cells"), parameters.tolist(), strict=True):
            self.task.report(f"calibration, {group}: logit = {c:.3f} + {a:.3f} ln p - {b:.3f} ln(1 - p)")
        return parameters


def selection_f1(score: StretchScore, source: FrameSource) -> float:
    """Mean F1 over SELECTION_STRATA and SELECTION_HORIZONS_S, of the values that are defined."""
    steps = [step_of(source, horizon) for horizon in SELECTION_HORIZONS_S]
    return mean_of_defined([float(score.f1[stratum][step]) for stratum in SELECTION_STRATA for step in steps])


def stretch_summary(score: StretchScore, source: FrameSource) -> dict[str, Any]:
    """The scores of one stretch for a card, without undefined ones."""
    columns = {
        "dynamic_log_loss": score.log_loss["dynamic"],
        "visible_f1": score.f1["visible"],
        "dynamic_f1": score.f1["dynamic"],
    }
    at = {f"{horizon:g}s": step_of(source, horizon) for horizon in SELECTION_HORIZONS_S}
    return {"stretch": source.name} | {
        name: {horizon: round(float(values[step]), 4) for horizon, step in at.items() if math.isfinite(values[step])}
        for name, values in columns.items()
    }


def step_of(source: FrameSource, horizon_s: float) -> int:
    """The step nearest to a horizon, at least 1."""
    return max(1, nearest_step(horizon_s, source.period_s))
