"""Training: the occupancy rate of each cell is counted on the training recordings, the settings are searched."""

from __future__ import annotations

from collections.abc import Sequence

from gridtrack.trackers.calibration import CalibratedTracker
from gridtrack.trackers.contract import FitOutput, FrameSource, Score
from gridtrack.trackers.dogma.masses import Mass
from gridtrack.trackers.dogma.settings import NAME, DogmaSettings
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


def fit_dogma(
    tracker: type[CalibratedTracker],
    train: Sequence[FrameSource],
    validation: Sequence[FrameSource],
    score: Score,
    out: FitOutput,
    options: DogmaSettings,
) -> None:
    """Write the counted occupancy rate, and the settings with the best F1 on excerpts of `train`, to `out.path`.

    A setting in `options` is not searched. Of the best settings those with the best F1 on `validation` are written. The
    forecast is calibrated on the excerpts. Raises WeightsError where the recordings differ in grid, period or site.
    """
    if out.general:
        visible, occupied = count_anywhere(train, lambda frame: (frame.visible, frame.occupied))
        rate = posterior_rate(occupied, visible)
    else:
        rate, moves = count_occupancy_rate(train)
        if moves:
            out.report(NO_MAP)
    search = SettingsSearch(NAME, tracker, DogmaSettings, DOGMA_RANGES, DOGMA_OF_PLACE, with_fewer_particles)
    given = options.model_dump(exclude_unset=True)
    fit_searched(search, {"occupancy_rate": rate}, train, validation, score, out, given, {})


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
