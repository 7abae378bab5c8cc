"""The time since each cell was last seen, at frames that were missed and in a window that scrolls."""

from __future__ import annotations

import numpy as np

from gridtrack.common.grid import Mask, Shift
from gridtrack.trackers.cell_records import HiddenTime


def seen(*cells: tuple[int, int]) -> Mask:
    visible = np.zeros((3, 3), bool)
    for cell in cells:
        visible[cell] = True
    return visible


def test_cells_count_the_time_between_frames_and_move_with_the_world() -> None:
    hidden = HiddenTime((3, 3))
    hidden.observe(seen((0, 0), (1, 2)), 0.1)
    hidden.observe(seen((0, 0)), 0.1)
    assert hidden.seconds[0, 0] == 0.0
    assert hidden.seconds[1, 2] == np.float32(0.1)
    assert np.isinf(hidden.seconds[2]).all()
    hidden.scroll(Shift(rows=0, columns=2))
    hidden.observe(seen(), 0.3)
    assert hidden.seconds[1, 0] == np.float32(0.1) + np.float32(0.3)
    assert np.isinf(hidden.seconds[:, 1:]).all()
