"""Training of occupancy: background and life table are counted, settings searched, probabilities calibrated."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gridtrack.trackers.contract import FitTask, FrameSource
from gridtrack.trackers.model_free.background import OUTSIDE_MAP, fit_background, general_background
from gridtrack.trackers.model_free.open_cells import OpenCells, OpenOnMap, OpenSoFar
from gridtrack.trackers.model_free.residence import fit_residence, general_residence, table_shape
from gridtrack.trackers.model_free.settings import PipelineSettings
from gridtrack.trackers.searched_fit import SettingsSearch, fit_searched
from gridtrack.trackers.site_map import SiteMap
from gridtrack.trackers.site_rate import NO_MAP

if TYPE_CHECKING:
    from gridtrack.trackers.model_free.tracker import ModelFreeTracker

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
PIPELINE_OF_PLACE = frozenset({"untracked_share", "rate_recovery_s", "static_above", "adaptation_s", "map_weight_s"})
"""Settings that weigh the map of the place against the stream: those of the background."""
WITHOUT_MAP = {"background": "none"}
"""The setting of a pipeline that finds its background while the stream goes."""


def fit_pipeline(tracker: type[ModelFreeTracker], task: FitTask) -> None:
    """Write the counted arrays, and the searched settings, to `task.out`.

    Raises WeightsError if the recordings differ in grid, period or site.
    """
    train, options = task.train, task.options
    given = options.model_dump(include=set(PipelineSettings.model_fields), exclude_unset=True)
    notes = {"classes": _without_classes(task)}
    arrays = general_arrays(train, options) if task.general else fit_arrays(train, options, task.report)
    search = SettingsSearch(
        tracker,
        PipelineSettings,
        SETTING_RANGES,
        PIPELINE_OF_PLACE,
        without_map=WITHOUT_MAP if (arrays["neighbourhood_rate"] < OUTSIDE_MAP).any() else {},
    )
    fit_searched(search, arrays, task, given, notes)


def _without_classes(task: FitTask) -> str:
    """The entry for classes in the card of a training without them."""
    if task.general:
        return "none: classes are learned at a site"
    if any(source.classes for source in task.train):
        return "none yet: add them with stage=classes"
    return f"none: {', '.join(source.name for source in task.train)} has no labels"


def general_arrays(train: Sequence[FrameSource], options: PipelineSettings) -> dict[str, NDArray[np.float32]]:
    """The counted arrays for any place: the mean rate, and a life table of any period."""
    residence = general_residence(train, 1.0 - options.explained_above)
    return {**general_background(train)._asdict(), "residence": residence}


def fit_arrays(
    train: Sequence[FrameSource], options: PipelineSettings, report: Callable[[str], None]
) -> dict[str, NDArray[np.float32]]:
    """The counted arrays: the background map, and the life table of the returns in open cells."""
    grid, period_s = train[0].grid, train[0].period_s
    background, moves = fit_background(train, grid.cell_m)
    if moves:
        report(NO_MAP)
    on_map = SiteMap(background.neighbourhood_rate < options.explained_above, True, grid.cell_m)

    def open_cells() -> OpenCells:
        return OpenSoFar(grid, period_s, 1.0 - options.explained_above) if moves else OpenOnMap(on_map)

    residence = fit_residence(train, open_cells, table_shape(period_s), grid.cell_m)
    return {**background._asdict(), "residence": residence}
