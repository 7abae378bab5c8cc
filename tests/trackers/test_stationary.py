"""The floor `stationary`: a table by the past of a cell, learned without motion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gridtrack.common.config import Settings
from gridtrack.common.errors import ConfigurationError
from gridtrack.common.grid import GridSpec
from gridtrack.trackers.contract import FitTask, StreamSpec
from gridtrack.trackers.stationary import (
    AGE_ENDS_S,
    DISTANCE_ENDS_M,
    RATE_ENDS,
    TABLE_BINS,
    TABLE_HORIZONS_S,
    CellPasts,
    StationaryTracker,
    counts_of,
    smoothed_rates,
)
from gridtrack.trackers.training.weights import read_card

from scenes.frames import Frames, frame_of

GRID = GridSpec(5, 1.0)
EMPTY = np.zeros((5, 5), bool)


def cells(*places: tuple[int, int]) -> np.ndarray:
    found = EMPTY.copy()
    for place in places:
        found[place] = True
    return found


def bins(past: CellPasts, axis: int) -> list[list[int]]:
    return np.unravel_index(past.bins(), TABLE_BINS)[axis].tolist()


def test_a_cell_is_known_by_its_rate_its_distance_to_a_moving_return_and_the_time_since_it_was_seen() -> None:
    past = CellPasts(GRID)
    wall, walker = (0, 0), (2, 2)
    for n in range(3):
        past.add(frame_of(cells(wall), second=0.5 * n))
    past.add(frame_of(cells(wall, walker), ~cells((4, 4)), second=1.5))
    rate, distance, age = (np.array(bins(past, axis)) for axis in range(3))
    assert rate[wall] == len(RATE_ENDS), "occupied in every frame"
    assert rate[walker] == RATE_ENDS.searchsorted(0.25)
    assert rate[1, 1] == 0
    assert distance[walker] == 0
    assert distance[wall] == DISTANCE_ENDS_M.searchsorted(np.sqrt(8)), "a wall is no moving return"
    assert distance[2, 3] == DISTANCE_ENDS_M.searchsorted(1.0)
    assert age[4, 4] == AGE_ENDS_S.searchsorted(0.5)
    assert (np.delete(age.ravel(), 24) == 0).all()


def test_without_a_moving_return_every_cell_is_far_and_a_cell_that_was_never_seen_has_an_age_of_its_own() -> None:
    past = CellPasts(GRID)
    past.add(frame_of(EMPTY, ~cells((1, 3))))
    assert (np.array(bins(past, 1)) == len(DISTANCE_ENDS_M)).all()
    assert np.array(bins(past, 2))[1, 3] == len(AGE_ENDS_S)


def test_the_past_of_a_cell_keeps_its_place_in_the_world() -> None:
    past, moved = CellPasts(GRID), CellPasts(GRID)
    past.add(frame_of(cells((2, 1)), second=0.0))
    past.add(frame_of(cells((2, 2)), second=0.5))
    moved.add(frame_of(cells((2, 3)), second=0.0, x=-2.0))
    moved.add(frame_of(cells((2, 2)), second=0.5, x=0.0))
    assert np.array_equal(past.bins()[:, :3], moved.bins()[:, :3])


def test_the_table_has_the_share_of_occupied_among_visible_cells_at_each_horizon() -> None:
    """A wall that flickers: occupied in every second frame of 0.1 s."""
    frames = [frame_of(cells((2, 2)) if n % 2 else EMPTY, second=n / 10) for n in range(60)]
    source = Frames(frames, GRID)
    visible, occupied = counts_of(source)
    at = {round(h, 2): n for n, h in enumerate(TABLE_HORIZONS_S)}
    forecasts = visible[at[0.0]].sum() / 25
    assert forecasts == 8, "after 20 frames, every half second"
    assert visible[at[2.5]].sum() == 3 * 25, "targets with a frame in the stretch"
    assert occupied[at[0.0]].sum() == occupied[at[0.2]].sum() == 4
    assert occupied[at[0.1]].sum() == 4


def test_a_rare_bin_has_the_rate_of_all_distances_and_an_unseen_one_too() -> None:
    visible, occupied = np.zeros((2, len(TABLE_HORIZONS_S), *TABLE_BINS))
    visible[0, 1, 3, 0], occupied[0, 1, 3, 0] = 1e6, 5e5
    visible[0, 1, 4, 0], occupied[0, 1, 4, 0] = 1, 0
    found = smoothed_rates(occupied, visible)
    assert found[0, 1, 3, 0] == pytest.approx(0.5, abs=1e-4)
    assert found[0, 1, 4, 0] == pytest.approx(20 * 0.5 / 21, abs=1e-3)
    assert found[0, 1, 5, 0] == pytest.approx(0.5, abs=1e-4)
    assert found[0, 6, 5, 2] == pytest.approx(0.5, abs=1e-4)


def task(tmp_path: Path, *, general: bool) -> FitTask:
    frames = [frame_of(cells((2, 1 + n % 3)), second=n / 10) for n in range(60)]
    source = Frames(frames, GRID)
    return FitTask([source], [], None, tmp_path / "general.toml", Settings(), tmp_path, general=general)


def test_a_fitted_table_is_forecast_between_its_horizons_and_kept_beyond_them(tmp_path: Path) -> None:
    StationaryTracker.fit(task(tmp_path, general=True))
    assert read_card(tmp_path / "general.toml").general
    stream = StreamSpec(GRID, 0.05, "elsewhere", weights=tmp_path / "general.toml")
    tracker = StationaryTracker(stream, Settings())
    for n in range(3):
        tracker.update(frame_of(cells((2, 2)), second=n / 20))
    forecast = tracker.predict(60).occupancy
    assert forecast.dtype == np.float32
    assert forecast[1] == pytest.approx((forecast[0] + forecast[2]) / 2, abs=1e-6)
    assert np.array_equal(forecast[50], forecast[60])
    tracker.reset(0)
    assert np.unique(tracker.predict(0).occupancy).size == 1, "nothing is known of any cell"


def test_it_has_no_weights_of_a_site(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="stationary learns for any place: add --general"):
        StationaryTracker.fit(replace(task(tmp_path, general=False)))
