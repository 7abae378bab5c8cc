"""The floor `advection`: the content of the window is carried on along the flow of the last frames."""

from __future__ import annotations

import numpy as np
import pytest

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.trackers.contract import StreamSpec

advection = pytest.importorskip("gridtrack.trackers.advection", reason="the extra advection is not installed")

SMALL = StreamSpec(GridSpec(5, 1.0), 1.0, "here")
WIDE = StreamSpec(GridSpec(40, 0.2), 0.1, "here")


def frame(occupied: np.ndarray, n: int, period_s: float, x: float = 0.0) -> GridFrame:
    none = np.zeros((0, 2), np.float32)
    seen = np.ones_like(occupied)
    return GridFrame(round(n * period_s * 1e9), seen, occupied, SE2(x, 0.0), none, none, np.zeros(0, np.uint8))


def tracker_on(stream: StreamSpec, **options: float):
    return advection.AdvectionTracker(stream, advection.AdvectionOptions(**options))


def block(row: float, column: float, size: int = 40) -> np.ndarray:
    """A block of 4 x 4 cells about a place."""
    rows, columns = np.mgrid[:size, :size]
    return (abs(rows - row) <= 2) & (abs(columns - column) <= 2)


def test_one_frame_stays_where_it_is() -> None:
    tracker = tracker_on(SMALL)
    occupied = np.eye(5, dtype=bool)
    tracker.update(frame(occupied, 0, 1.0))
    assert tracker.predict(3).occupancy.tolist() == [occupied.astype(float).tolist()] * 4
    tracker.reset(0)
    assert not tracker.predict(1).occupancy.any()


def test_standing_objects_stay() -> None:
    tracker = tracker_on(SMALL)
    occupied = np.zeros((5, 5), bool)
    occupied[1:3, 2] = True
    for n in range(4):
        tracker.update(frame(occupied, n, 1.0))
    assert tracker.predict(2).occupancy == pytest.approx(np.tile(occupied.astype(float), (3, 1, 1)), abs=1e-3)


def test_a_uniform_flow_carries_a_cell_of_a_5_x_5_grid_by_whole_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    """One column a frame, found over two frames; entering cells are free."""
    back = np.zeros((2, 5, 5), np.float32)
    back[1] = -2.0
    monkeypatch.setattr(advection, "optical_flow_tvl1", lambda now, before, **_: back)
    tracker = tracker_on(SMALL, lookback_s=2.0)
    for n in range(3):
        occupied = np.zeros((5, 5), bool)
        occupied[2, n] = True
        tracker.update(frame(occupied, n, 1.0))
    found = [np.argwhere(step > 0.5).tolist() for step in tracker.predict(3).occupancy]
    assert found == [[[2, 2]], [[2, 3]], [[2, 4]], []]


def test_a_moving_block_is_carried_on_in_its_direction() -> None:
    tracker = tracker_on(WIDE, lookback_s=0.25, smoothing_m=0.3)
    for n in range(10):
        tracker.update(frame(block(20, 8 + n), n, 0.1))
    forecast = tracker.predict(8).occupancy
    columns = [np.average(np.arange(40), weights=step.sum(axis=0)) for step in forecast]
    assert columns[0] == pytest.approx(17.0)
    assert columns[8] == pytest.approx(25.0, abs=2.0)
    assert forecast.min() >= 0.0
    assert forecast.max() <= 1.0


def test_the_motion_of_the_window_is_no_flow() -> None:
    """The sensor moves a cell a frame to the right; a block stands in the world."""
    tracker = tracker_on(WIDE)
    for n in range(10):
        tracker.update(frame(block(20, 25 - n), n, 0.1, x=0.2 * n))
    forecast = tracker.predict(8).occupancy
    assert forecast[8] == pytest.approx(forecast[0], abs=0.02)
