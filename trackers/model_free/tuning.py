"""Training of occupancy: background and life table are counted, settings searched, probabilities calibrated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gridtrack.trackers.contract import FitOutput, FrameSource, Score, StretchScore, stream_of
from gridtrack.trackers.model_free.background import fit_background
from gridtrack.trackers.model_free.calibration import IDENTITY, fit_calibration
from gridtrack.trackers.model_free.residence import fit_residence, table_shape
from gridtrack.trackers.model_free.settings import PipelineSettings
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

if TYPE_CHECKING:
    from gridtrack.trackers.model_free.tracker import ModelFreeTracker

SEARCH_ITERATIONS = 40
STARTING_SETTINGS = (
    PipelineSettings(),
    PipelineSettings(
        untracked_share=0.541,
        rate_recovery_s=0.628,
        static_above=0.119,
        adaptation_s=1.29,
        map_weight_s=1.01,
        link_m=0.245,
        acceleration=0.0643,
        speed_noise=0.0719,
        turn_acceleration=0.0519,
        manoeuvre_noise=5.2,
        steady_duration_s=9.71,
        manoeuvre_duration_s=2.05,
        velocity_memory_s=22.5,
        initial_speed=5.11,
        initial_turn_rate=0.0511,
        surface_noise_m=0.0915,
        position_noise_m=0.0297,
        reach_m=0.209,
        initiation_probability=0.171,
        detection_probability=0.792,
        clutter_probability=0.121,
        mean_lifetime_s=19.2,
        shape_memory_s=1.83,
        residence_speed=0.306,
        return_noise_m=0.182,
    ),
)
"""Start of the search: pedestrians and an indoor laser; the traffic of a street and a fast laser."""
EXCERPTS, EXCERPT_S = 2, 100.0
"""Number and duration of the excerpts of a long recording for the search; each is longer than a signal cycle."""
OBJECTIVE_HORIZONS_S = (0.5, 1.0, 2.0)
OBJECTIVE_STRATA = ("dynamic", "visible")
"""The objective is the mean F1 over these. Vehicles that wait at a red light are static in a stretch of one or two
minutes, and are scored among the visible cells only."""
SETTING_RANGES = {
    "untracked_share": (0.02, 1.0),
    "rate_recovery_s": (0.3, 10.0),
    "static_above": (0.1, 0.8),
    "adaptation_s": (0.5, 10.0),
    "map_weight_s": (0.2, 5.0),
    "link_m": (0.15, 1.2),
    "acceleration": (0.02, 1.0),
    "speed_noise": (0.01, 0.3),
    "turn_acceleration": (0.01, 0.5),
    "manoeuvre_noise": (2.0, 40.0),
    "steady_duration_s": (1.0, 30.0),
    "manoeuvre_duration_s": (0.3, 5.0),
    "velocity_memory_s": (0.5, 50.0),
    "initial_speed": (0.5, 8.0),
    "initial_turn_rate": (0.02, 1.0),
    "surface_noise_m": (0.05, 0.25),
    "position_noise_m": (0.02, 0.3),
    "reach_m": (0.2, 1.5),
    "initiation_probability": (0.1, 0.8),
    "detection_probability": (0.5, 0.98),
    "clutter_probability": (0.02, 0.5),
    "mean_lifetime_s": (2.0, 60.0),
    "shape_memory_s": (0.2, 4.0),
    "residence_speed": (0.2, 20.0),
    "return_noise_m": (0.02, 0.2),
}
"""Ranges of the tuned settings, searched log-uniformly."""


def excerpts(sources: Sequence[FrameSource]) -> list[FrameSource]:
    """The sources for the search; a long one is replaced by EXCERPTS of EXCERPT_S, evenly distributed over it."""
    chosen: list[FrameSource] = []
    for source in sources:
        count = round(EXCERPT_S / source.period_s)
        if len(source) <= EXCERPTS * count:
            chosen.append(source)
        else:
            firsts = (round((2 * n + 1) * len(source) / (2 * EXCERPTS)) - count // 2 for n in range(EXCERPTS))
            chosen += [CachedSource.excerpt(source, first, count) for first in firsts]
    return chosen


@dataclass(frozen=True, slots=True)
class _Draft:
    """Weights in training: `tracker` runs with those at `path` and is scored by `score`."""

    tracker: type[ModelFreeTracker]
    path: Path
    score: Score

    def running(self, settings: PipelineSettings, source: FrameSource) -> ModelFreeTracker:
        return self.tracker(stream_of(source, self.path), settings)

    def scores(self, settings: PipelineSettings, sources: Sequence[FrameSource]) -> list[StretchScore]:
        last = max(OBJECTIVE_HORIZONS_S)
        return [self.score(self.running(settings, source), source, step_of(source, last)) for source in sources]

    def mean_f1(self, settings: PipelineSettings, sources: Sequence[FrameSource]) -> float:
        scored = zip(self.scores(settings, sources), sources, strict=True)
        return float(np.mean([_f1(score, source) for score, source in scored]))

    def summaries(self, settings: PipelineSettings, sources: Sequence[FrameSource]) -> list[dict[str, Any]]:
        scored = zip(self.scores(settings, sources), sources, strict=True)
        return [stretch_summary(score, source, OBJECTIVE_HORIZONS_S) for score, source in scored]

    def calibration(
        self, settings: PipelineSettings, sources: Sequence[FrameSource], out: FitOutput
    ) -> NDArray[np.float32]:
        trackers = [(self.running(settings, source), list(source)) for source in sources]
        parameters = fit_calibration(trackers, step_of(sources[0], max(OBJECTIVE_HORIZONS_S)))
        for group, (a, b, c) in zip(("cells seen recently", "other cells"), parameters.tolist(), strict=True):
            out.report(f"calibration, {group}: logit = {c:.3f} + {a:.3f} ln p - {b:.3f} ln(1 - p)")
        return parameters


def fit_pipeline(
    tracker: type[ModelFreeTracker],
    train: Sequence[FrameSource],
    validation: Sequence[FrameSource],
    score: Score,
    out: FitOutput,
    options: PipelineSettings,
) -> None:
    """Write the counted arrays, and the settings with the best F1 on excerpts of `train`, to `out.path`.

    A setting in `options` is not searched. The forecast is calibrated on the same excerpts. `validation` is scored with
    the result and reported only. Raises WeightsError where the recordings differ in grid, period or site.
    """
    arrays = fit_arrays(train, options) | {"calibration": IDENTITY}
    card = card_for(tracker.name, out, train, validation, {})
    searched = excerpts(train)
    with TemporaryDirectory() as folder:
        draft = _Draft(tracker, Path(folder) / f"{tracker.name}.toml", score)
        save_weights(draft.path, card, arrays)
        given = options.model_dump(include=set(PipelineSettings.model_fields), exclude_unset=True)
        objective = Objective[PipelineSettings]("mean F1", "maximize", lambda tried: draft.mean_f1(tried, searched))
        try:
            settings = search_settings(
                PipelineSettings, SETTING_RANGES, objective, STARTING_SETTINGS, given, SEARCH_ITERATIONS, train, out
            )
        except SearchInterrupted as stopped:
            card = card_for(tracker.name, out, train, validation, stopped.best.model_dump(), {"classes": "none yet"})
            save_interrupted(out.path, card, arrays, f"{stopped.reached}, not calibrated")
            raise
        arrays["calibration"] = draft.calibration(settings, searched, out)
        save_weights(draft.path, card, arrays)
        results: dict[str, Any] = {
            "train": draft.summaries(settings, searched),
            "validation": draft.summaries(settings, validation),
            "classes": _without_classes(train),
        }
    card = card_for(tracker.name, out, train, validation, settings.model_dump(), results)
    save_weights(out.path, card, arrays)
    delete_search_log(out)


def _without_classes(train: Sequence[FrameSource]) -> str:
    """The entry for classes in the card of a training without them."""
    if any(source.classes for source in train):
        return "none yet: add them with stage=classes"
    return f"none: {', '.join(source.name for source in train)} has no labels"


def fit_arrays(train: Sequence[FrameSource], options: PipelineSettings) -> dict[str, NDArray[np.float32]]:
    """The counted arrays: the background map, and the life table of the returns in open cells."""
    background = fit_background((frame for source in train for frame in source), train[0].grid.shape)
    open_cells = background.neighbourhood_rate < options.explained_above
    residence = fit_residence(train, open_cells, table_shape(train[0].period_s))
    return {**background._asdict(), "residence": residence}


def _f1(score: StretchScore, source: FrameSource) -> float:
    """Mean F1 over OBJECTIVE_HORIZONS_S and OBJECTIVE_STRATA."""
    steps = [step_of(source, horizon) for horizon in OBJECTIVE_HORIZONS_S]
    return float(np.mean([score.f1[stratum][steps] for stratum in OBJECTIVE_STRATA]))
