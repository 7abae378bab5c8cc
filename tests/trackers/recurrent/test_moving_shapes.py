"""Windows of moving shapes: dense, at walking speeds in cells a step, seen from one side."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from gridtrack.trackers.recurrent.motion import entered_cells, moving_shapes
from gridtrack.trackers.recurrent.motion import moving_shapes as shapes


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


def test_shapes_hide_what_is_behind_them_and_cells_out_of_range_are_never_seen(monkeypatch):
    window = moving_shapes(np.random.default_rng(1), 30, 64)
    seen = window[:, 0].mean(axis=0)
    assert ((seen > 0) & (seen < 1)).mean() > 0.05, "hidden now and then"
    monkeypatch.setattr(shapes, "HIDING_SHAPES", 0.0)
    monkeypatch.setattr(shapes, "LASER_RANGES", (3.0, 3.0))
    assert moving_shapes(np.random.default_rng(1), 30, 64)[:, 0].all()
    monkeypatch.setattr(shapes, "LASER_RANGES", (0.7, 0.7))
    seen = np.stack([moving_shapes(np.random.default_rng(seed), 9, 64)[:, 0].any(axis=0) for seed in range(10)])
    assert 0.2 < seen.mean() < 0.9


def test_a_shape_moves_straight_on_at_its_speed(monkeypatch):
    """One disc that is seen all round, 1.5 cells a step without a turn: its centre moves so."""
    monkeypatch.setattr(shapes, "FEWEST", 1)
    monkeypatch.setattr(shapes, "MOST", 1)
    monkeypatch.setattr(shapes, "RECTANGLES", 0.0)
    monkeypatch.setattr(shapes, "LOST_SHARE", 0.0)
    monkeypatch.setattr(shapes, "HIDING_SHAPES", 0.0)
    monkeypatch.setattr(shapes, "LASER_RANGES", (3.0, 3.0))
    monkeypatch.setattr(shapes, "STANDING_SHAPES", 0.0)
    monkeypatch.setattr(shapes, "TURN", 0.0)
    monkeypatch.setattr(shapes, "SPEEDS", (1.5, 1.5))
    monkeypatch.setattr(shapes, "RADII", (2.0, 2.0))
    measured = 0
    for seed in range(40):
        window = moving_shapes(np.random.default_rng(seed), 9, 60)[:, 1]
        centres = [np.argwhere(frame).mean(axis=0) for frame in window if frame.sum() >= 4]
        if len(centres) == 9 and min(np.min(centres), 59 - np.max(centres)) > 4:  # whole in the window all the time
            measured += 1
            assert np.linalg.norm(centres[-1] - centres[0]) / 8 == pytest.approx(1.5, abs=0.15)
    assert measured > 5
