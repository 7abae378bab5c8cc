"""Training: the occupancy rate of each cell is counted on the training recordings, the settings are searched."""

from __future__ import annotations

from collections.abc import Sequence

from gridtrack.trackers.calibration import CalibratedTracker
from gridtrack.trackers.contract import FitTask, FrameSource
from gridtrack.trackers.dogma.masses import Mass
from gridtrack.trackers.dogma.settings import DogmaSettings
from gridtrack.trackers.searched_fit import SettingsSearch, fit_searched
from gridtrack.trackers.site_rate import NO_MAP, count_anywhere, count_frames, posterior_rate

PARTICLE_DIVISOR = 4
"""Divisor of the number of particles during the search, for speed; the calibration and the result have all of them."""
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
DOGMA_OF_PLACE = frozenset({"free_decay_s"})
"""The setting that weighs the map of the place against the stream: what is not free counts with the rate of the map."""


def fit_dogma(tracker: type[CalibratedTracker], task: FitTask) -> None:
    """Write the counted occupancy rate, and the searched settings, to `task.out`.

    Raises WeightsError if the recordings differ in grid, period or site.
    """
    if task.general:
        visible, occupied = count_anywhere(task.train, lambda frame: (frame.visible, frame.occupied))
        rate = posterior_rate(occupied, visible)
    else:
        rate, moves = count_occupancy_rate(task.train)
        if moves:
            task.report(NO_MAP)
    search = SettingsSearch(tracker, DogmaSettings, DOGMA_RANGES, DOGMA_OF_PLACE, with_fewer_particles)
    fit_searched(search, {"occupancy_rate": rate}, task, task.options.model_dump(exclude_unset=True), {})


def with_fewer_particles(settings: DogmaSettings) -> DogmaSettings:
    """The settings with which a try of the search is scored."""
    return settings.model_copy(update={"particles": max(100, settings.particles // PARTICLE_DIVISOR)})


def count_occupancy_rate(train: Sequence[FrameSource]) -> tuple[Mass, bool]:
    """P(occupied | visible) of each cell (M, M) float32, and whether a sensor moves (`count_frames`).

    The posterior mean over all frames of `train`.
    """
    (visible, occupied), moves = count_frames(
        train, train[0].grid.cell_m, lambda frame: (frame.visible, frame.occupied)
    )
    return posterior_rate(occupied, visible), moves
