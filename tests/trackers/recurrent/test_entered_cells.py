"""Cells that something enters in a window: what moves does, what stands does not, nor the noise round it."""

from __future__ import annotations

import pytest

torch = pytest.importorskip("torch")

from gridtrack.trackers.recurrent.motion import LOOKBACK_STEPS, NEAR_CELLS, entered_cells, near_entered_cells

STEPS, SIZE = 30, 24


def window():
    """All cells are visible; a wall in column 20, and a dot that walks along row 5, half a cell a step."""
    cells = torch.zeros(1, STEPS, 2, SIZE, SIZE, dtype=torch.bool)
    cells[:, :, 0] = True
    cells[:, :, 1, :, 20] = True
    for t in range(STEPS):
        cells[0, t, 1, 5, t // 2] = True
    return cells


def test_a_dot_that_walks_enters_a_cell_in_every_frame_and_a_wall_in_none():
    found = entered_cells(window())[0]
    for t in range(STEPS):
        expected = [[5, t // 2]] if t >= LOOKBACK_STEPS else []
        assert found[t].nonzero().tolist() == expected, t


def test_what_comes_and_goes_beside_a_wall_is_noise_of_its_range():
    cells = window()
    cells[0, 12:15, 1, 10, 19] = True
    assert not entered_cells(cells)[0, :, 10].any()


def test_where_nobody_looked_before_nothing_enters():
    cells = window()
    cells[0, :LOOKBACK_STEPS, :, 5] = False
    assert not entered_cells(cells)[0, : 2 * LOOKBACK_STEPS, 5].any()


def test_the_cells_near_an_entered_one_are_a_square_without_the_wall():
    cells = window()
    cells[0, :, 1, 5, :] = False
    cells[0, 20, 1, 5, 16] = True
    near = near_entered_cells(cells)[0]
    assert not near[:20].any()
    rows, columns = near[20].nonzero().unbind(dim=1)
    assert (rows.min(), rows.max(), columns.min()) == (5 - NEAR_CELLS, 5 + NEAR_CELLS, 16 - NEAR_CELLS)
    assert columns.max() == 18, "the wall and the cells beside it stand"
