"""Records of cells: the time since they were seen, and open cells, seen empty with all their neighbours."""

from __future__ import annotations

import numpy as np
import pytest

from gridtrack.common.grid import GridFrame, Mask, Shift
from gridtrack.trackers.cell_records import HiddenTime, OpenSpace, open_cells

from scenes import frames


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


PERIOD_S = 0.1


def cells_of(drawing: str, marks: str) -> Mask:
    return np.array([[cell in marks for cell in row] for row in drawing.split()])


def frame_of(drawing: str) -> GridFrame:
    """A frame from a drawing: `.` seen empty, `#` a return, `?` not seen."""
    return frames.frame_of(cells_of(drawing, "#"), cells_of(drawing, ".#"))


@pytest.mark.parametrize(
    ("drawing", "opened"),
    [
        ("..... ..... ..... ..... .....", "ooooo ooooo ooooo ooooo ooooo"),
        ("..... ..... ..... ..... ....#", "ooooo ooooo ooooo ooo.. ooo.."),
        # Beams along a wall at the right: they cross its cells between two returns, and the cells behind are hidden.
        ("...#? ....? ....? ...#? ....?", "oo... oo... oo... oo... oo..."),
        # The edge of a shadow.
        ("..... ..#.. ..??. ..??? .....", "o...o o.... o.... o.... o...."),
        # Two beams two cells apart.
        ("..... ????? ..... ????? .....", "..... ..... ..... ..... ....."),
    ],
)
def test_a_cell_is_open_when_it_is_seen_empty_with_all_its_neighbours(drawing: str, opened: str) -> None:
    assert (open_cells(frame_of(drawing)) == cells_of(opened, "o")).all()


def test_visible_parts_of_a_wall_that_comes_into_view_lie_in_closed_cells() -> None:
    space = OpenSpace((5, 5), PERIOD_S)
    along = frame_of("...#? ....? ....? ...#? ....?")
    nearer = frame_of("...#? ...#? ...#? ...#? ...#?")
    for _ in range(10):
        space.observe(along, 1)
    assert space.closed(0.0)[nearer.occupied].all()
    assert not space.closed(0.5)[1:4, 1].any()


def test_the_record_moves_with_the_window_and_counts_only_frames_in_which_a_cell_is_visible() -> None:
    space = OpenSpace((5, 5), PERIOD_S)
    space.observe(frame_of("..... ..... ..... ..... ....."), 1)
    space.observe(frame_of("????? ????? ????? ????? ?????"), 50)
    assert not space.closed(0.9).any()
    space.scroll(Shift(rows=0, columns=2))
    assert not space.closed(0.9)[:, :3].any()
    assert space.closed(0.9)[:, 3:].all()
