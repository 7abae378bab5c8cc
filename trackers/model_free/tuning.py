"""Tuning: background and life table counted on the training recordings, and a seeded search of the settings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import optuna
from numpy.typing import NDArray

from gridtrack.trackers.contract import FitOutput, FrameSource, Score, StretchScore, Tracker, stream_of
from gridtrack.trackers.model_free.background import explained_cells, fit_background
from gridtrack.trackers.model_free.dwell import fit_dwell, table_shape
from gridtrack.trackers.model_free.settings import NAME, PipelineSettings
from gridtrack.trackers.weights import card_for, save_weights

TRIALS = 80
REPORT_EVERY = 10
HORIZONS_S = (0.2, 0.5, 1.0, 2.0)
"""What is tuned for: the mean over these of the log loss on moving cells."""
RANGES = {
    "link_m": (0.15, 2.0),
    "velocity_memory_s": (0.5, 50.0),
    "acceleration": (0.2, 3.0),
    "position_noise_m": (0.03, 0.5),
    "reach_m": (0.2, 3.0),
    "life_s": (2.0, 60.0),
    "return_noise_m": (0.02, 0.2),
    "unforeseen_share": (0.02, 1.0),
}
"""Settings that are tuned, each from its range, log-uniformly."""


def fit_pipeline(
    tracker: type[Tracker],
    train: Sequence[FrameSource],
    validation: Sequence[FrameSource],
    score: Score,
    out: FitOutput,
    options: PipelineSettings,
) -> None:
    """Write to `out.path` the arrays that are counted and the settings with the least loss on the training recordings.

    A setting given in `options` stays as given. `validation` is scored with the result, and reported only. The search
    minimises log loss, a proper score: it sees a forecast grow rightly unsure where a walker will be, which the F1 at
    the best threshold of a short stretch does not tell from chance. Raises WeightsError where the recordings differ in
    grid, period or site.
    """
    arrays = fit_arrays(train, options)
    with TemporaryDirectory() as folder:
        draft = Path(folder) / f"{NAME}.toml"
        save_weights(draft, card_for(NAME, out, train, validation, {}), arrays)

        def scores(settings: PipelineSettings, sources: Sequence[FrameSource]) -> list[StretchScore]:
            return [
                score(tracker(stream_of(source, draft), settings), source, step_of(source, max(HORIZONS_S)))
                for source in sources
            ]

        def loss(settings: PipelineSettings) -> float:
            return float(np.mean([_loss(s, source) for s, source in zip(scores(settings, train), train, strict=True)]))

        settings = search(loss, options.model_dump(exclude_unset=True), out.seed, out.report)
        results = {
            stretch: [_summary(s, source) for s, source in zip(scores(settings, sources), sources, strict=True)]
            for stretch, sources in (("train", train), ("validation", validation))
        }
    card = card_for(NAME, out, train, validation, settings.model_dump(), results)
    save_weights(out.path, card, arrays)


def fit_arrays(train: Sequence[FrameSource], options: PipelineSettings) -> dict[str, NDArray[np.float32]]:
    """What is counted and not tuned: the background map, and the life table of the returns in front of it."""
    background = fit_background((frame for source in train for frame in source), train[0].grid.shape)
    open_cells = ~explained_cells(background, options.explained_above)
    return {"background": background, "dwell": fit_dwell(train, open_cells, table_shape(train[0].period_s))}


def search(
    loss: Callable[[PipelineSettings], float], given: dict[str, Any], seed: int, report: Callable[[str], None]
) -> PipelineSettings:
    """The settings of least `loss` in TRIALS trials of a tree-structured Parzen estimator, the defaults first.

    Settings in `given` are kept. The same seed makes the same search.
    """
    tuned = {key: bounds for key, bounds in RANGES.items() if key not in given}

    def objective(trial: optuna.Trial) -> float:
        return loss(PipelineSettings(**given, **{key: _rounded(trial, key, *tuned[key]) for key in tuned}))

    def tell(study: optuna.Study, trial: optuna.trial.FrozenTrial) -> None:
        if trial.number % REPORT_EVERY == 0:
            report(f"{NAME}: trial {trial.number + 1} of {TRIALS}, log loss {study.best_value:.5f}")

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=seed, multivariate=True))
    defaults = PipelineSettings()
    study.enqueue_trial({key: getattr(defaults, key) for key in tuned})
    study.optimize(objective, n_trials=TRIALS, callbacks=[tell])
    best = {key: _three_digits(value) for key, value in study.best_params.items()}
    return PipelineSettings(**given, **best)


def step_of(source: FrameSource, horizon_s: float) -> int:
    """The step nearest to a horizon."""
    return max(1, round(horizon_s / source.period_s))


def _loss(score: StretchScore, source: FrameSource) -> float:
    """Mean log loss on moving cells over HORIZONS_S."""
    return float(np.mean([score.log_loss["moving"][step_of(source, horizon)] for horizon in HORIZONS_S]))


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
