"""The floor `advection`: the content of the window is carried on along the flow of the last frames."""

from __future__ import annotations

import numpy as np
import pytest

from gridtrack.common.grid import GridSpec
from gridtrack.trackers.contract import StreamSpec

from scenes.frames import frame_of

advection = pytest.importorskip("gridtrack.trackers.advection", reason="the extra advection is not installed")

SMALL = StreamSpec(GridSpec(5, 1.0), 1.0, "here")
WIDE = StreamSpec(GridSpec(40, 0.2), 0.1, "here")


def tracker_on(stream: StreamSpec, **options: float):
    return advection.AdvectionTracker(stream, advection.AdvectionOptions(**options))


def block(row: float, column: float, size: int = 40) -> np.ndarray:
    """A block of 4 x 4 cells about a place."""
    rows, columns = np.mgrid[:size, :size]
    return (abs(rows - row) <= 2) & (abs(columns - column) <= 2)


def test_one_frame_stays_where_it_is() -> None:
    tracker = tracker_on(SMALL)
    occupied = np.eye(5, dtype=bool)
    tracker.update(frame_of(occupied))
    assert tracker.predict(3).occupancy.tolist() == [occupied.astype(float).tolist()] * 4
    tracker.reset(0)
    assert not tracker.predict(1).occupancy.any()


def test_a_uniform_flow_carries_a_cell_of_a_5_x_5_grid_by_whole_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    """One column a frame, found over two frames; entering cells are free."""
    back = np.zeros((2, 5, 5), np.float32)
    back[1] = -2.0
    monkeypatch.setattr(advection, "optical_flow_tvl1", lambda now, before, **_: back)
    tracker = tracker_on(SMALL, lookback_s=2.0)
    for n in range(3):
        occupied = np.zeros((5, 5), bool)
        occupied[2, n] = True
        tracker.update(frame_of(occupied, second=n))
    found = [np.argwhere(step > 0.5).tolist() for step in tracker.predict(3).occupancy]
    assert found == [[[2, 2]], [[2, 3]], [[2, 4]], []]


def test_a_moving_block_is_carried_on_in_its_direction() -> None:
    tracker = tracker_on(WIDE, lookback_s=0.25, smoothing_m=0.3)
    for n in range(10):
        tracker.update(frame_of(block(20, 8 + n), second=0.1 * n))
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
        tracker.update(frame_of(block(20, 25 - n), second=0.1 * n, x=0.2 * n))
    forecast = tracker.predict(8).occupancy
    assert forecast[8] == pytest.approx(forecast[0], abs=0.02)
