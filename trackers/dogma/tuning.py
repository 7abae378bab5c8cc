"""Tuning: what is usual at a site counted on the training recordings, and a seeded search of the settings."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from gridtrack.trackers.contract import FitOutput, FrameSource, Score, StretchScore, Tracker, stream_of
from gridtrack.trackers.dogma.masses import Mass
from gridtrack.trackers.dogma.settings import NAME, DogmaSettings
from gridtrack.trackers.site_rate import posterior_rate
from gridtrack.trackers.tuning import HeldSource, Measure, search, step_of, summary
from gridtrack.trackers.weights import card_for, save_weights

TRIALS = 30
HORIZONS_S = (0.2, 0.5, 1.0, 2.0)
"""What is tuned for: the mean over these of the log loss on moving cells. It is a proper score: it sees a forecast grow
rightly unsure of where a walker will be, which the F1 at the best threshold of a short stretch does not."""
TUNED_ON_S = 96.0
"""How much of each training recording the settings are tuned on, from its beginning: the map wants all of it."""
TUNED_WITH = 4
"""The search makes do with the number of particles divided by this, for its speed; the results reported do not."""
RANGES = {
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
"""Settings that are tuned, each from its range, log-uniformly."""


def fit_dogma(
    tracker: type[Tracker],
    train: Sequence[FrameSource],
    validation: Sequence[FrameSource],
    score: Score,
    out: FitOutput,
    options: DogmaSettings,
) -> None:
    """Write to `out.path` the map that is counted and the settings with the least loss on the training recordings.

    A setting given in `options` stays as given. `validation` is scored with the result, and reported only. Raises
    WeightsError where the recordings differ in grid, period or site.
    """
    arrays = {"occupancy_rate": count_occupancy_rate(train)}
    held = [HeldSource.beginning(source, TUNED_ON_S) for source in train]
    with TemporaryDirectory() as folder:
        draft = Path(folder) / f"{NAME}.toml"
        save_weights(draft, card_for(NAME, out, train, validation, {}), arrays)

        def scored(settings: DogmaSettings, source: FrameSource) -> StretchScore:
            return score(tracker(stream_of(source, draft), settings), source, step_of(source, max(HORIZONS_S)))

        def loss(settings: DogmaSettings) -> float:
            fewer = settings.model_copy(update={"particles": max(100, settings.particles // TUNED_WITH)})
            return float(np.mean([_moving_loss(scored(fewer, source), source) for source in held]))

        given = options.model_dump(exclude_unset=True)
        settings = search(
            DogmaSettings, RANGES, Measure("log loss", "minimize", loss), (DogmaSettings(),), given, TRIALS, out
        )
        results = {
            "train": [summary(scored(settings, source), source, HORIZONS_S) for source in held],
            "validation": [summary(scored(settings, source), source, HORIZONS_S) for source in validation],
        }
    save_weights(out.path, card_for(NAME, out, train, validation, settings.model_dump(), results), arrays)


def count_occupancy_rate(train: Sequence[FrameSource]) -> Mass:
    """P(occupied | visible) of each cell, (M, M) float32, over all frames of `train`, as a posterior mean."""
    visible, occupied = np.zeros((2, *train[0].grid.shape))
    for frame in (frame for source in train for frame in source):
        visible += frame.visible
        occupied += frame.occupied
    return posterior_rate(occupied, visible)


def _moving_loss(score: StretchScore, source: FrameSource) -> float:
    """Mean log loss on moving cells over HORIZONS_S."""
    return float(np.mean([score.log_loss["moving"][step_of(source, horizon)] for horizon in HORIZONS_S]))
