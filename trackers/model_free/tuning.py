"""Tuning: background and life table counted on the training recordings, and a seeded search of the settings."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
import optuna
from numpy.typing import NDArray

from gridtrack.common.grid import GridFrame, LabelledFrame
from gridtrack.trackers.contract import FitOutput, FrameSource, Score, StretchScore, stream_of
from gridtrack.trackers.model_free.background import fit_background
from gridtrack.trackers.model_free.dwell import fit_dwell, table_shape
from gridtrack.trackers.model_free.settings import PipelineSettings
from gridtrack.trackers.weights import card_for, save_weights

if TYPE_CHECKING:
    from gridtrack.trackers.model_free.tracker import ModelFreeTracker

TRIALS = 40
REPORT_EVERY = 5
EXCERPTS, EXCERPT_S = 2, 100.0
"""The search runs over as many excerpts of a longer recording, each longer than a signal cycle."""
HORIZONS_S = (0.5, 1.0, 2.0)
STRATA = ("moving", "visible")
"""What is tuned for: the mean F1 over these. In a minute or two, what waits at a red light counts as static, and is
scored among the visible cells alone."""
RANGES = {
    "unforeseen_share": (0.02, 1.0),
    "return_s": (0.3, 10.0),
    "sink_above": (0.1, 0.8),
    "sink_s": (0.5, 10.0),
    "link_m": (0.15, 1.2),
    "acceleration": (0.2, 3.0),
    "velocity_memory_s": (0.5, 50.0),
    "turn_acceleration": (0.02, 1.0),
    "initial_speed": (0.5, 8.0),
    "surface_m": (0.05, 0.25),
    "position_noise_m": (0.02, 0.3),
    "reach_m": (0.2, 1.5),
    "birth_probability": (0.1, 0.8),
    "life_s": (2.0, 60.0),
    "shape_memory_s": (0.2, 4.0),
    "dwell_speed": (0.2, 20.0),
    "return_noise_m": (0.02, 0.2),
}
"""Settings that are tuned, each from its range, log-uniformly."""


class Excerpt:
    """Frames of a source, held in memory so that no trial of the search need read them again: a FrameSource."""

    def __init__(self, source: FrameSource, first: int, count: int) -> None:
        self.name = f"{source.name}, {count * source.period_s:g} s from {first * source.period_s:g} s on"
        self.sha256, self.grid, self.period_s = source.sha256, source.grid, source.period_s
        self.site, self.classes = source.site, source.classes
        self._frames = list(islice(source, first, first + count))

    def __iter__(self) -> Iterator[GridFrame]:
        return iter(self._frames)

    def __len__(self) -> int:
        return len(self._frames)

    def labelled(self) -> Iterator[LabelledFrame]:
        """Of an excerpt no classes are known."""
        nothing = np.zeros(0, np.int64), np.zeros(0, np.uint8)
        return (LabelledFrame(frame, *nothing) for frame in self._frames)


def excerpts(sources: Sequence[FrameSource]) -> list[FrameSource]:
    """What the search runs over: the sources, and of a long one EXCERPTS of EXCERPT_S, evenly spread over it."""
    chosen: list[FrameSource] = []
    for source in sources:
        count = round(EXCERPT_S / source.period_s)
        if len(source) <= EXCERPTS * count:
            chosen.append(source)
        else:
            firsts = (round((2 * n + 1) * len(source) / (2 * EXCERPTS)) - count // 2 for n in range(EXCERPTS))
            chosen += [Excerpt(source, first, count) for first in firsts]
    return chosen


def fit_pipeline(
    tracker: type[ModelFreeTracker],
    train: Sequence[FrameSource],
    validation: Sequence[FrameSource],
    score: Score,
    out: FitOutput,
    options: PipelineSettings,
) -> None:
    """Write to `out.path` the arrays that are counted, and the settings with the best F1 on excerpts of `train`.

    A setting given in `options` stays as given. `validation` is scored with the result, and reported only. Raises
    WeightsError where the recordings differ in grid, period or site.
    """
    name = tracker.name
    arrays = fit_arrays(train, options)
    searched = excerpts(train)
    with TemporaryDirectory() as folder:
        draft = Path(folder) / f"{name}.toml"
        save_weights(draft, card_for(name, out, train, validation, {}), arrays)

        def scores(settings: PipelineSettings, sources: Sequence[FrameSource]) -> list[StretchScore]:
            return [
                score(tracker(stream_of(source, draft), settings), source, step_of(source, max(HORIZONS_S)))
                for source in sources
            ]

        def goodness(settings: PipelineSettings) -> float:
            found = zip(scores(settings, searched), searched, strict=True)
            return float(np.mean([_f1(one, source) for one, source in found]))

        settings = search(goodness, options.model_dump(exclude_unset=True), out.seed, out.report)
        results = {
            stretch: [_summary(s, source) for s, source in zip(scores(settings, sources), sources, strict=True)]
            for stretch, sources in (("train", searched), ("validation", validation))
        }
    card = card_for(name, out, train, validation, settings.model_dump(), results)
    save_weights(out.path, card, arrays)


def fit_arrays(train: Sequence[FrameSource], options: PipelineSettings) -> dict[str, NDArray[np.float32]]:
    """What is counted and not tuned: the background map, and the life table of the returns in front of it."""
    background = fit_background((frame for source in train for frame in source), train[0].grid.shape)
    open_cells = background.solid < options.explained_above
    dwell = fit_dwell(train, open_cells, table_shape(train[0].period_s))
    return {**background._asdict(), "dwell": dwell}


def search(
    goodness: Callable[[PipelineSettings], float], given: dict[str, Any], seed: int, report: Callable[[str], None]
) -> PipelineSettings:
    """The settings of most `goodness` in TRIALS trials of a tree-structured Parzen estimator, the defaults first.

    Settings in `given` are kept; where they are all that is tuned, they are the answer. The same seed makes the same
    search.
    """
    tuned = {key: bounds for key, bounds in RANGES.items() if key not in given}
    if not tuned:
        return PipelineSettings(**given)

    def objective(trial: optuna.Trial) -> float:
        return goodness(PipelineSettings(**given, **{key: _rounded(trial, key, *tuned[key]) for key in tuned}))

    def tell(study: optuna.Study, trial: optuna.trial.FrozenTrial) -> None:
        if trial.number % REPORT_EVERY == 0:
            report(f"trial {trial.number + 1} of {TRIALS}, mean F1 {study.best_value:.4f}")

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    sampler = optuna.samplers.TPESampler(seed=seed, multivariate=True)
    study = optuna.create_study(direction="maximize", sampler=sampler)
    defaults = PipelineSettings()
    study.enqueue_trial({key: getattr(defaults, key) for key in tuned})
    study.optimize(objective, n_trials=TRIALS, callbacks=[tell])
    best = {key: _three_digits(value) for key, value in study.best_params.items()}
    return PipelineSettings(**given, **best)


def step_of(source: FrameSource, horizon_s: float) -> int:
    """The step nearest to a horizon."""
    return max(1, round(horizon_s / source.period_s))


def _f1(score: StretchScore, source: FrameSource) -> float:
    """Mean F1 over HORIZONS_S and STRATA."""
    steps = [step_of(source, horizon) for horizon in HORIZONS_S]
    return float(np.mean([score.f1[stratum][steps] for stratum in STRATA]))


def _summary(score: StretchScore, source: FrameSource) -> dict[str, Any]:
    """What the card says of one stretch."""
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


def _rounded(trial: optuna.Trial, key: str, low: float, high: float) -> float:
    return _three_digits(trial.suggest_float(key, low, high, log=True))


def _three_digits(value: float) -> float:
    """Three significant digits: a card is read by people, and the search must try what the card will say."""
    return float(f"{value:.3g}")
