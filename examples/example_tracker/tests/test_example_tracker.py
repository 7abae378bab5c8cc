"""The fading memory against hand-computed values, and through the contract suite."""
# ruff: noqa: D103

from __future__ import annotations

import numpy as np
from example_tracker import FadingOptions, FadingTracker

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.evaluation.processes.contract_suite import check_tracker
from gridtrack.trackers.contract import StreamSpec
from gridtrack.trackers.selection import launch

STREAM = StreamSpec(GridSpec(2, 1.0), period_s=0.5)


def frame(visible: list[list[int]], occupied: list[list[int]]) -> GridFrame:
    none = np.zeros((0, 2), np.float32)
    return GridFrame(0, np.array(visible, bool), np.array(occupied, bool), SE2(), none, none, np.zeros(0, np.uint8))


def test_a_cell_fades_by_half_in_its_half_life() -> None:
    tracker = FadingTracker(STREAM, FadingOptions(half_life_s=0.5, background=0.0))
    tracker.update(frame([[1, 1], [0, 0]], [[1, 0], [0, 0]]))
    assert tracker.predict(2).occupancy[:, 0, 0].tolist() == [1.0, 0.5, 0.25]
    tracker.update(frame([[0, 0], [0, 0]], [[0, 0], [0, 0]]))
    assert tracker.predict(1).occupancy[:, 0, 0].tolist() == [0.5, 0.25]


def test_it_keeps_the_contract() -> None:
    results = check_tracker(launch("fading"), StreamSpec(GridSpec(40, 0.2), 0.125), {"half_life_s": 2.0})
    assert [result for result in results if result.verdict != "passed"] == []
