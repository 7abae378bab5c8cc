"""The floors: persistence, static map and blank forecast the values that their definitions give."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gridtrack.common.config import Settings
from gridtrack.common.errors import WeightsError
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.trackers.baselines import BlankTracker, PersistenceTracker, StaticMapOptions, StaticMapTracker
from gridtrack.trackers.contract import FitTask, StreamSpec

from scenes.frames import Frames, frame_of

GRID = GridSpec(2, 1.0)
STREAM = StreamSpec(GRID, 0.1, "here")
ALL, NONE = [[1, 1], [1, 1]], [[0, 0], [0, 0]]


def test_persistence_keeps_the_last_observed_state_and_unobserved_cells_free() -> None:
    tracker = PersistenceTracker(STREAM, Settings())
    tracker.reset(0)
    tracker.update(frame_of([[1, 0], [1, 0]], [[1, 1], [1, 0]]))
    tracker.update(frame_of([[0, 1], [0, 0]], [[1, 1], [0, 0]]))
    forecast = tracker.predict(2).occupancy
    assert forecast.dtype == np.float32
    tracker.update(frame_of(ALL))
    assert forecast.tolist() == [[[0, 1], [1, 0]]] * 3, "later frames do not change it"
    tracker.reset(0)
    assert not tracker.predict(0).occupancy.any()


def test_persistence_keeps_each_cell_at_its_place_in_the_world() -> None:
    tracker = PersistenceTracker(STREAM, Settings())
    tracker.update(frame_of([[1, 0], [0, 1]], x=5.0, y=-3.0))
    tracker.update(frame_of(NONE, NONE, x=5.0, y=-2.0))
    assert tracker.predict(1).occupancy.tolist() == [[[0, 1], [0, 0]]] * 2
    tracker.update(frame_of(NONE, NONE, x=6.0, y=-2.0))
    assert tracker.predict(0).occupancy.tolist() == [[[1, 0], [0, 0]]]
    tracker.update(frame_of(NONE, NONE, x=900.0, y=-2.0))
    assert not tracker.predict(0).occupancy.any()
    tracker.reset(0)
    tracker.update(frame_of([[1, 0], [0, 0]], [[1, 0], [0, 0]]))
    assert tracker.predict(0).occupancy.tolist() == [[[1, 0], [0, 0]]]


def test_blank_forecasts_zero() -> None:
    tracker = BlankTracker(STREAM, Settings())
    tracker.update(frame_of(ALL))
    assert tracker.predict(4).occupancy.shape == (5, 2, 2)
    assert not tracker.predict(4).occupancy.any()


def test_the_static_map_is_the_rate_of_each_cell_with_the_overall_rate_as_prior(tmp_path: Path) -> None:
    full = [[1, 1], [1, 0]]
    frames = [
        frame_of([[1, 0], [0, 0]], full),
        frame_of([[1, 1], [0, 0]], full),
        frame_of([[1, 0], [0, 0]], [[1, 0], [0, 0]]),
    ]
    lines: list[str] = []
    out = fitted(tmp_path, *frames, report=lines.append)
    tracker = StaticMapTracker(StreamSpec(GRID, 0.1, "here", weights=out), StaticMapOptions(prior_frames=1.0))
    rate = 4 / 7  # 3 + 1 occupied of 3 + 2 + 2 visible
    expected = [[(3 + rate) / 4, (1 + rate) / 3], [rate / 3, rate]]
    np.testing.assert_allclose(tracker.predict(1).occupancy, [expected, expected], rtol=1e-6)
    assert len(lines) == 1


def fitted(tmp_path: Path, *frames: GridFrame, report: Callable[[str], None] = print) -> Path:
    out, source = tmp_path / "here.toml", Frames(list(frames), GRID)
    StaticMapTracker.fit(FitTask([source], [], None, out, StaticMapOptions(), tmp_path, report=report))
    return out


def test_a_static_map_spans_the_windows_of_a_moving_sensor_and_has_the_overall_rate_outside(tmp_path: Path) -> None:
    path = fitted(
        tmp_path,
        frame_of([[1, 0], [0, 0]], x=5.0, y=5.0),
        frame_of([[0, 0], [0, 1]], x=2.0, y=4.0),
        frame_of([[0, 0], [1, 0]], x=8.0, y=5.0),
    )
    tracker = StaticMapTracker(StreamSpec(GRID, 0.1, "here", weights=path), StaticMapOptions(prior_frames=0.0))
    for x, y, expected in (
        (5.0, 5.0, [[1, 0], [0, 0]]),
        (2.0, 4.0, [[0, 0], [0, 1]]),
        (8.0, 5.0, [[0, 0], [1, 0]]),
        (4.0, 5.0, [[0.25, 1], [0.25, 0]]),
        (1e4, 5.0, [[0.25, 0.25], [0.25, 0.25]]),
    ):
        tracker.update(frame_of(ALL, x=x, y=y))
        assert tracker.predict(0).occupancy.tolist() == [expected]


def test_a_static_map_of_a_long_drive_is_refused_in_one_line(tmp_path: Path) -> None:
    frames = [frame_of(ALL), frame_of(ALL, x=5000.0)]
    with pytest.raises(WeightsError, match="5002 cells, and a map has at most 4096 per side"):
        fitted(tmp_path, *frames)


def test_the_static_map_refuses_training_data_without_visible_cells(tmp_path: Path) -> None:
    with pytest.raises(WeightsError, match="no cell is visible in rec@0s-1s"):
        fitted(tmp_path, frame_of(NONE, NONE))
