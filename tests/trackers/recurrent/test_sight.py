"""Cells in the sight of a laser, by hand in windows of five cells."""

from __future__ import annotations

import numpy as np
import pytest

from gridtrack.trackers.recurrent.motion import cells_in_sight


def drawn(window):
    """Cells of a drawing: `#` is occupied."""
    return np.array([[cell == "#" for cell in row] for row in window], np.uint8)


def in_sight(window, laser):
    """A drawing of the window, seen from the `laser` at a column and a row: `-` is hidden."""
    found = cells_in_sight(drawn(window)[None], np.array(laser, float))[0]
    return ["".join("." if cell else "-" for cell in row) for row in found]


def test_what_lies_behind_a_cell_is_hidden_but_for_the_one_next_to_it():
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
