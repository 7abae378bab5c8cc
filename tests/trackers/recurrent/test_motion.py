"""Motion in training windows: shapes that move and hide each other, lines of sight, and cells that something enters."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from gridtrack.trackers.recurrent import motion
from gridtrack.trackers.recurrent.motion import (
    LOOKBACK_STEPS,
    NEAR_CELLS,
    cells_in_sight,
    entered_cells,
    moving_shapes,
    near_entered_cells,
)


def test_a_window_depends_on_its_draw_alone_and_much_of_it_moves():
    one, same, other = (moving_shapes(np.random.default_rng(seed), 30, 64) for seed in (1, 1, 2))
    assert np.array_equal(one, same)
    assert not np.array_equal(one, other)
    visible, occupied = one[:, 0], one[:, 1]
    assert 0.3 < visible.mean() < 1.0
    assert 0.005 < occupied.sum() / visible.sum() < 0.1
    assert not (occupied & ~visible).any()
    entered = entered_cells(torch.from_numpy(one)[None].bool())
    assert entered[0, 10:].flatten(1).any(dim=1).all()


def test_shapes_hide_cells_behind_them_and_cells_out_of_range_are_never_seen(monkeypatch):
    window = moving_shapes(np.random.default_rng(1), 30, 64)
    seen = window[:, 0].mean(axis=0)
    assert ((seen > 0) & (seen < 1)).mean() > 0.05, "hidden now and then"
    monkeypatch.setattr(motion, "HIDING_SHAPES", 0.0)
    monkeypatch.setattr(motion, "LASER_RANGES", (3.0, 3.0))
    assert moving_shapes(np.random.default_rng(1), 30, 64)[:, 0].all()
    monkeypatch.setattr(motion, "LASER_RANGES", (0.7, 0.7))
    seen = np.stack([moving_shapes(np.random.default_rng(seed), 9, 64)[:, 0].any(axis=0) for seed in range(10)])
    assert 0.2 < seen.mean() < 0.9


def test_a_shape_moves_straight_on_at_its_speed(monkeypatch):
    """One disc that is seen all round, 1.5 cells a step without a turn: its centre moves so."""
    alone = {"FEWEST": 1, "MOST": 1, "RECTANGLES": 0.0, "STANDING_SHAPES": 0.0, "RADII": (2.0, 2.0)}
    seen = {"LOST_SHARE": 0.0, "HIDING_SHAPES": 0.0, "LASER_RANGES": (3.0, 3.0)}
    for name, value in (alone | seen | {"TURN": 0.0, "SPEEDS": (1.5, 1.5)}).items():
        monkeypatch.setattr(motion, name, value)
    measured = 0
    for seed in range(40):
        window = moving_shapes(np.random.default_rng(seed), 9, 60)[:, 1]
        centres = [np.argwhere(frame).mean(axis=0) for frame in window if frame.sum() >= 4]
        if len(centres) == 9 and min(np.min(centres), 59 - np.max(centres)) > 4:  # whole in the window all the time
            measured += 1
            assert np.linalg.norm(centres[-1] - centres[0]) / 8 == pytest.approx(1.5, abs=0.15)
    assert measured > 5


def drawn(window):
    """Cells of a drawing: `#` is occupied."""
    return np.array([[cell == "#" for cell in row] for row in window], np.uint8)


def in_sight(window, laser):
    """A drawing of the window, seen from the `laser` at a column and a row: `-` is hidden."""
    found = cells_in_sight(drawn(window)[None], np.array(laser, float))[0]
    return ["".join("." if cell else "-" for cell in row) for row in found]


def test_all_cells_behind_a_cell_are_hidden_except_the_next_one():
    """The cell, half a cell before the laser, fills the view from -45 to 45 degrees."""
    assert in_sight([".....", ".....", ".#...", ".....", "....."], (0.5, 2.5)) == [
        "....-", "...--", "...--", "...--", "....-",
    ]  # fmt: skip


def test_the_shadow_widens_with_the_distance_from_a_laser_outside_of_the_window():
    found = in_sight(["..#..", ".....", ".....", ".....", "....."], (2.5, -0.5))
    assert found == [".....", ".....", ".---.", "-----", "-----"]


def test_the_line_to_a_corner_is_diagonal():
    found = in_sight([".....", ".#...", ".....", ".....", "....."], (0.5, 0.5))
    assert [found[number][number] for number in range(5)] == [".", ".", ".", "-", "-"]


def test_a_side_seen_from_its_end_is_seen_at_its_end():
    assert in_sight([".....", ".....", ".###.", ".....", "....."], (0.5, 2.5))[2] == "...--"


def test_each_frame_has_its_own_shadows_and_an_empty_one_has_none():
    frames = np.stack([drawn(["....."] * 5), drawn(["#...."] * 5)])
    found = cells_in_sight(frames, np.array([-2.5, 2.5]))
    assert found[0].all()
    assert found[1, :, :2].all()
    assert not found[1, :, 2:].any()


@pytest.mark.parametrize("laser", [(32.0, 32.0), (-20.0, 70.0), (10.3, 64.0), (90.0, 5.5)])
def test_every_cell_is_on_a_line_from_the_laser(laser):
    assert cells_in_sight(np.zeros((1, 64, 64), np.uint8), np.array(laser)).all()


def test_the_line_to_the_middle_of_a_hidden_cell_meets_an_occupied_one():
    draw = np.random.default_rng(1)
    occupied = (draw.random((1, 24, 24)) < 0.03).astype(np.uint8)
    laser = np.array([-3.0, 7.3])
    hidden = ~cells_in_sight(occupied, laser)[0]
    fractions, free = np.linspace(0.0, 1.0, 200)[:, None], 0
    for row, column in np.argwhere(hidden):
        line = laser + (np.array([column, row]) + 0.5 - laser) * fractions
        cells = np.unique(line[(line >= 0).all(axis=1)].astype(int), axis=0)
        free += not occupied[0, cells[:, 1], cells[:, 0]].any()
    assert hidden.sum() > 100
    assert free < 0.05 * hidden.sum(), "but for the rounding of lines to cells"


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


def test_returns_that_come_and_go_beside_a_wall_are_range_noise():
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
