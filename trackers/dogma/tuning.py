"""Training: the occupancy rate of each cell is counted on the training recordings, the settings are searched."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from gridtrack.trackers.contract import FitOutput, FrameSource, Score, StretchScore, Tracker, stream_of
from gridtrack.trackers.dogma.masses import Mass
from gridtrack.trackers.dogma.settings import NAME, DogmaSettings
from gridtrack.trackers.site_rate import posterior_rate
from gridtrack.trackers.tuning import (
    CachedSource,
    Objective,
    SearchInterrupted,
    delete_search_log,
    search_settings,
    step_of,
    stretch_summary,
)
from gridtrack.trackers.weights import card_for, save_interrupted, save_weights

DOGMA_ITERATIONS = 30
DOGMA_HORIZONS_S = (0.2, 0.5, 1.0, 2.0)
"""The objective is the mean log loss on dynamic cells over these. A proper score rewards the increasing uncertainty of
the forecast of a walker, which the F1 at the best threshold of a short stretch does not."""
TUNED_ON_S = 96.0
"""Duration of the part of each training recording, from its start, for the search; the rate is counted on all of it."""
PARTICLE_DIVISOR = 4
"""Divisor of the number of particles during the search, for speed; reported results have all particles."""
DOGMA_RANGES = {
    "occupied_mass": (0.8, 0.98),
    "free_mass": (0.7, 0.98),
    "birth_probability": (1e-4, 0.1),
    "free_decay_s": (0.5, 20.0),
    "birth_speed": (0.5, 15.0),
    "acceleration": (0.05, 3.0),
    "position_noise_m": (0.002, 0.1),
    "start_stop_speed": (0.1, 3.0),
    "time_to_start_s": (2.0, 200.0),
    "time_to_stop_s": (0.3, 30.0),
}
"""Ranges of the tuned settings, searched log-uniformly."""


def fit_dogma(
    tracker: type[Tracker],
    train: Sequence[FrameSource],
    validation: Sequence[FrameSource],
    score: Score,
    out: FitOutput,
    options: DogmaSettings,
) -> None:
    """Write the counted occupancy rate, and the settings with the least log loss on `train`, to `out.path`.

    A setting in `options` is not searched. `validation` is scored with the result and reported only. Raises
    WeightsError where the recordings differ in grid, period or site.
    """
    arrays = {"occupancy_rate": count_occupancy_rate(train)}
    cached = [CachedSource.beginning(source, TUNED_ON_S) for source in train]
    with TemporaryDirectory() as folder:
        draft = Path(folder) / f"{NAME}.toml"
        save_weights(draft, card_for(NAME, out, train, validation, {}), arrays)

        def scored(settings: DogmaSettings, source: FrameSource) -> StretchScore:
            return score(tracker(stream_of(source, draft), settings), source, step_of(source, max(DOGMA_HORIZONS_S)))

        def loss(settings: DogmaSettings) -> float:
            fewer = settings.model_copy(update={"particles": max(100, settings.particles // PARTICLE_DIVISOR)})
            return float(np.mean([_moving_loss(scored(fewer, source), source) for source in cached]))

        given = options.model_dump(exclude_unset=True)
        objective = Objective("log loss", "minimize", loss)
        try:
            settings = search_settings(
                DogmaSettings, DOGMA_RANGES, objective, (DogmaSettings(),), given, DOGMA_ITERATIONS, train, out
            )
        except SearchInterrupted as stopped:
            card = card_for(NAME, out, train, validation, stopped.best.model_dump())
            save_interrupted(out.path, card, arrays, stopped.reached)
            raise
        results = {
            "train": [stretch_summary(scored(settings, source), source, DOGMA_HORIZONS_S) for source in cached],
            "validation": [
                stretch_summary(scored(settings, source), source, DOGMA_HORIZONS_S) for source in validation
            ],
        }
    save_weights(out.path, card_for(NAME, out, train, validation, settings.model_dump(), results), arrays)
    delete_search_log(out)


def count_occupancy_rate(train: Sequence[FrameSource]) -> Mass:
    """P(occupied | visible) of each cell (M, M) float32, the posterior mean over all frames of `train`."""
    visible, occupied = np.zeros((2, *train[0].grid.shape))
    for frame in (frame for source in train for frame in source):
        visible += frame.visible
        occupied += frame.occupied
    return posterior_rate(occupied, visible)


def _moving_loss(score: StretchScore, source: FrameSource) -> float:
    """Mean log loss on dynamic cells over DOGMA_HORIZONS_S."""
    return float(np.mean([score.log_loss["dynamic"][step_of(source, horizon)] for horizon in DOGMA_HORIZONS_S]))
