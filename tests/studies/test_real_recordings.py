"""The windows of the real recordings: where a laser that stands looks, and about one that turns."""

from __future__ import annotations

from gridtrack.recordings import open_recording
from gridtrack.recordings.opening import packaged_recording

from studies.support.real_recordings import REAL


def test_the_window_of_corridor_is_that_of_the_shipped_part_of_it() -> None:
    (corridor,) = (one for one in REAL if one.name == "corridor")
    assert corridor.grid == open_recording(packaged_recording("leg_tracker")).info.grid


def test_a_laser_that_moves_is_in_the_middle_of_its_window() -> None:
    middles = {one.name: f"100x{one.cell_m:g}@-{50 * one.cell_m:g},-{50 * one.cell_m:g}" for one in REAL if one.moves}
    assert middles == {one.name: one.grid for one in REAL if one.moves}
