"""The fading memory: against values computed by hand, the contract, and its scores on a short recording."""
# ruff: noqa: D103

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from example_tracker import FadingOptions, FadingTracker

from gridtrack import SE2, ConfigurationError, GridFrame, GridSpec, StreamSpec, packaged_recording

STREAM = StreamSpec(GridSpec(2, 1.0), period_s=0.5)


def frame(at_s: float, visible: list[list[int]], occupied: list[list[int]]) -> GridFrame:
    none, stamp_ns = np.zeros((0, 2), np.float32), round(1e9 * at_s)
    planes = np.array(visible, bool), np.array(occupied, bool)
    return GridFrame(stamp_ns, *planes, SE2(), none, none, np.zeros(0, np.uint8))


def test_a_cell_fades_by_half_in_its_half_life() -> None:
    tracker = FadingTracker(STREAM, FadingOptions(half_life_s=0.5))
    tracker.update(frame(0.0, [[1, 1], [0, 0]], [[1, 0], [0, 0]]))
    np.testing.assert_allclose(tracker.predict(2).occupancy[:, 0, 0], [1.0, 0.51, 0.265])
    tracker.update(frame(0.5, [[0, 0], [0, 0]], [[0, 0], [0, 0]]))
    np.testing.assert_allclose(tracker.predict(1).occupancy[:, 0, 0], [0.51, 0.265])


def test_a_cell_fades_by_the_time_of_the_frames_that_are_missing() -> None:
    tracker = FadingTracker(STREAM, FadingOptions(half_life_s=0.5))
    tracker.update(frame(0.0, [[1, 1], [0, 0]], [[1, 0], [0, 0]]))
    tracker.update(frame(1.0, [[0, 0], [0, 0]], [[0, 0], [0, 0]]))
    np.testing.assert_allclose(tracker.predict(1).occupancy[:, 0, 0], [0.265, 0.1425])


def test_a_half_life_of_nothing_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="half_life_s = 0: expected more than 0 s"):
        FadingTracker(STREAM, FadingOptions(half_life_s=0.0))


def test_it_keeps_the_contract(tracker_contract: Any) -> None:
    tracker_contract("fading:half_life_s=2")


def test_it_is_not_worse_than_before(tracker_regression: Any) -> None:
    # after an intended change: pytest --gridtrack-update-baseline
    demo = packaged_recording("leg_tracker")
    options = {"validation": f"{demo}@75s-81s", "horizon_s": 1.0, "every_s": 0.5, "tolerance": 0.01}
    tracker_regression("fading", f"{demo}@114s-120s", baseline="example_tracker.json", **options)
