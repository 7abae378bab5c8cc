"""The floors: persistence, static map and blank forecast the values that their definitions give."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gridtrack.common.config import Settings
from gridtrack.common.errors import WeightsError
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.trackers.baselines import (
    BlankTracker,
    PersistenceTracker,
    StaticMapOptions,
    StaticMapTracker,
)
from gridtrack.trackers.contract import FitTask, StreamSpec, StretchScore

GRID = GridSpec(2, 1.0)
STREAM = StreamSpec(GRID, 0.1, "here")


def frame(visible: list[list[int]], occupied: list[list[int]], x: float = 0.0, y: float = 0.0) -> GridFrame:
    """A frame with its window at (x, y) in the world."""
    none = np.zeros((0, 2), np.float32)
    pose = SE2(x, y)
    return GridFrame(0, np.array(visible, bool), np.array(occupied, bool), pose, none, none, np.zeros(0, np.uint8))


@dataclass
class Frames:
    frames: list[GridFrame]
    name: str = "rec@0s-1s"
    sha256: str = "ab"
    grid: GridSpec = GRID
    period_s: float = 0.1
    site: str = "here"
    classes: tuple[str, ...] = ()

    def __iter__(self) -> Iterator[GridFrame]:
        return iter(self.frames)

    def __len__(self) -> int:
        return len(self.frames)


def no_score(*_: Any) -> StretchScore:
    raise AssertionError("the static map needs no score")


def test_persistence_keeps_the_last_observed_state_and_unobserved_cells_free() -> None:
    tracker = PersistenceTracker(STREAM, Settings())
    tracker.reset(0)
    tracker.update(frame([[1, 1], [1, 0]], [[1, 0], [1, 0]]))
    tracker.update(frame([[1, 1], [0, 0]], [[0, 1], [0, 0]]))
    forecast = tracker.predict(2).occupancy
    assert forecast.dtype == np.float32
    assert forecast.tolist() == [[[0, 1], [1, 0]]] * 3
    tracker.reset(0)
    assert not tracker.predict(0).occupancy.any()


def test_a_forecast_of_persistence_does_not_change_with_later_frames() -> None:
    tracker = PersistenceTracker(STREAM, Settings())
    tracker.reset(0)
    forecast = tracker.predict(1).occupancy
    tracker.update(frame([[1, 1], [1, 1]], [[1, 1], [1, 1]]))
    assert not forecast.any()


def test_persistence_keeps_each_cell_at_its_place_in_the_world() -> None:
    tracker = PersistenceTracker(STREAM, Settings())
    tracker.update(frame([[1, 1], [1, 1]], [[1, 0], [0, 1]], x=5.0, y=-3.0))
    tracker.update(frame([[0, 0], [0, 0]], [[0, 0], [0, 0]], x=5.0, y=-2.0))
    assert tracker.predict(1).occupancy.tolist() == [[[0, 1], [0, 0]]] * 2
    tracker.update(frame([[0, 0], [0, 0]], [[0, 0], [0, 0]], x=6.0, y=-2.0))
    assert tracker.predict(0).occupancy.tolist() == [[[1, 0], [0, 0]]]
    tracker.update(frame([[0, 0], [0, 0]], [[0, 0], [0, 0]], x=900.0, y=-2.0))
    assert not tracker.predict(0).occupancy.any()
    tracker.reset(0)
    tracker.update(frame([[1, 0], [0, 0]], [[1, 0], [0, 0]]))
    assert tracker.predict(0).occupancy.tolist() == [[[1, 0], [0, 0]]]


def test_blank_forecasts_zero() -> None:
    tracker = BlankTracker(STREAM, Settings())
    tracker.update(frame([[1, 1], [1, 1]], [[1, 1], [1, 1]]))
    assert tracker.predict(4).occupancy.shape == (5, 2, 2)
    assert not tracker.predict(4).occupancy.any()


def test_the_static_map_is_the_rate_of_each_cell_with_the_overall_rate_as_prior(tmp_path: Path) -> None:
    full = [[1, 1], [1, 0]]
    frames = [frame(full, [[1, 0], [0, 0]]), frame(full, [[1, 1], [0, 0]]), frame([[1, 0], [0, 0]], [[1, 0], [0, 0]])]
    lines: list[str] = []
    out = fitted(tmp_path, *frames, report=lines.append)
    tracker = StaticMapTracker(StreamSpec(GRID, 0.1, "here", weights=out), StaticMapOptions(prior_frames=1.0))
    rate = 4 / 7  # 3 + 1 occupied of 3 + 2 + 2 visible
    expected = [[(3 + rate) / 4, (1 + rate) / 3], [rate / 3, rate]]
    np.testing.assert_allclose(tracker.predict(1).occupancy, [expected, expected], rtol=1e-6)
    assert len(lines) == 1


def fitted(tmp_path: Path, *frames: GridFrame, report: Callable[[str], None] = print) -> Path:
    out = tmp_path / "here.toml"
    StaticMapTracker.fit(
        FitTask([Frames(list(frames))], [], no_score, out, StaticMapOptions(), tmp_path, report=report)
    )
    return out


def test_a_window_takes_the_part_of_the_static_map_at_its_place_and_the_overall_rate_outside(tmp_path: Path) -> None:
    all_seen = [[1, 1], [1, 1]]
    path = fitted(tmp_path, frame(all_seen, [[1, 0], [0, 0]], x=7.0, y=2.0))
    tracker = StaticMapTracker(StreamSpec(GRID, 0.1, "here", weights=path), StaticMapOptions(prior_frames=0.0))
    assert tracker.predict(0).occupancy.tolist() == [[[1, 0], [0, 0]]]
    tracker.update(frame(all_seen, all_seen, x=6.0, y=2.0))
    assert tracker.predict(1).occupancy.tolist() == [[[0.25, 1], [0.25, 0]]] * 2
    tracker.update(frame(all_seen, all_seen, x=6.0, y=1.0))
    assert tracker.predict(0).occupancy.tolist() == [[[0.25, 0.25], [0.25, 1]]]
    tracker.update(frame(all_seen, all_seen, x=1e4, y=1.0))
    assert tracker.predict(0).occupancy.tolist() == [[[0.25, 0.25], [0.25, 0.25]]]


def test_a_static_map_spans_the_windows_of_a_training_on_a_moving_sensor(tmp_path: Path) -> None:
    all_seen = [[1, 1], [1, 1]]
    path = fitted(
        tmp_path,
        frame(all_seen, [[1, 0], [0, 0]], x=5.0, y=5.0),
        frame(all_seen, [[0, 0], [0, 1]], x=2.0, y=4.0),
        frame(all_seen, [[0, 0], [1, 0]], x=8.0, y=5.0),
    )
    tracker = StaticMapTracker(StreamSpec(GRID, 0.1, "here", weights=path), StaticMapOptions(prior_frames=0.0))
    for x, y, expected in (
        (5.0, 5.0, [[1, 0], [0, 0]]),
        (2.0, 4.0, [[0, 0], [0, 1]]),
        (8.0, 5.0, [[0, 0], [1, 0]]),
        (4.0, 5.0, [[0.25, 1], [0.25, 0]]),
    ):
        tracker.update(frame(all_seen, all_seen, x=x, y=y))
        assert tracker.predict(0).occupancy.tolist() == [expected]


def test_a_static_map_of_a_long_drive_is_refused_in_one_line(tmp_path: Path) -> None:
    all_seen = [[1, 1], [1, 1]]
    frames = [frame(all_seen, all_seen), frame(all_seen, all_seen, x=5000.0)]
    with pytest.raises(WeightsError, match="5002 cells, and a map has at most 4096 per side"):
        fitted(tmp_path, *frames)


def test_the_static_map_refuses_training_data_without_visible_cells(tmp_path: Path) -> None:
    with pytest.raises(WeightsError, match="no cell is visible in rec@0s-1s"):
        fitted(tmp_path, frame([[0, 0]] * 2, [[0, 0]] * 2))


def test_the_static_map_without_weights_names_the_command_that_makes_them() -> None:
    with pytest.raises(WeightsError, match="make them with `gridtrack train static-map RECORDING`"):
        StaticMapTracker(STREAM, StaticMapOptions())
