"""Stages of the pipeline against hand-computed cases: background, residence, existence."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gridtrack.trackers.model_free.background import OUTSIDE_MAP, Background, BackgroundMap, fit_background
from gridtrack.trackers.model_free.residence import (
    NOT_OCCUPIED,
    PRIOR_RETURNS,
    fit_residence,
    next_ages,
    probability_in_place,
)
from gridtrack.trackers.model_free.settings import PipelineSettings
from gridtrack.trackers.model_free.tracks import existence_when_detected, existence_when_missed

from scenes import frames


def frame_of(visible, occupied):
    return frames.frame_of(occupied, visible)


# Background


def test_the_neighbourhood_rate_is_high_at_a_noisy_wall_and_not_at_an_equally_busy_cell():
    seen = np.ones((5, 9), bool)
    shown = []
    for step in range(1000):
        occupied = np.zeros((5, 9), bool)
        occupied[2, 1 + step % 2] = True
        occupied[2, 6:8] = step % 2 == 0
        shown.append(frame_of(seen, occupied))
    background, _ = fit_background([shown], 0.2)
    assert background.occupancy_rate[2, [1, 2, 6, 7]] == pytest.approx(0.5, abs=0.01)
    assert (background.neighbourhood_rate[1:4, 1:3] > 0.98).all()
    assert (background.neighbourhood_rate[:, 5:] < 0.55).all()


MAP_FRAMES = 40


def background_of(rate, neighbourhood_rate=0.0, **settings):
    given = {
        "explained_above": 0.9,
        "untracked_share": 0.5,
        "rate_recovery_s": 2.0,
        "static_above": 0.3,
        "adaptation_s": 5.0,
    }
    given["map_weight_s"] = 0.1 * MAP_FRAMES
    rate = np.asarray(rate, np.float32)
    fitted = BackgroundMap(rate, np.broadcast_to(np.asarray(neighbourhood_rate, np.float32), rate.shape))
    return Background(fitted, 0.1, PipelineSettings(**given | settings))


def test_the_forecast_has_walls_and_the_base_rate_of_cells_never_seen():
    background = background_of([[0.9, 0.1], [0.31, 0.0]], [[0.99, 0.0], [0.0, 0.0]])
    assert background.probabilities(1) == pytest.approx(np.array([[[0.9, 0.1], [0.31, 0.0]]] * 2))


def test_a_cell_seen_empty_recovers_to_its_rate_ahead_in_time_and_while_hidden():
    background = background_of([[0.1]], untracked_share=0.25, rate_recovery_s=2.0)
    seen, empty = np.ones((1, 1), bool), np.zeros((1, 1), bool)
    background.observe(frame_of(seen, empty))
    for hidden in range(3):
        shares = [1 - 0.75 * math.exp(-(hidden + step) * 0.1 / 2.0) for step in range(3)]
        assert background.probabilities(2).ravel() == pytest.approx([0.1 * share for share in shares], rel=1e-5)
        background.observe(frame_of(empty, empty))
    background.observe(frame_of(seen, empty))
    assert background.probabilities(0).item() == pytest.approx(0.025)


def test_stopped_objects_become_background_and_departed_ones_do_not_remain_in_it():
    background = background_of([[0.0, 0.0]])
    seen, parked = np.ones((1, 2), bool), np.array([[True, False]])
    for _ in range(100):
        background.observe(frame_of(seen, parked))
    keep = math.exp(-0.1 / 5.0)
    frames = (1 - keep**100) / (1 - keep)
    sunk = np.array([[frames / (frames + MAP_FRAMES), 0.0]])
    assert background.probabilities(0)[0] == pytest.approx(sunk)
    for _ in range(100):
        background.observe(frame_of(~seen, ~seen))
    assert background.probabilities(0)[0] == pytest.approx(sunk)  # hidden is not gone
    for _ in range(100):
        background.observe(frame_of(seen, ~seen))
    assert background.probabilities(0)[0] == pytest.approx(np.zeros((1, 2)))


def test_a_frame_after_missing_ones_counts_for_all_of_them():
    seen, parked, hidden = np.ones((1, 2), bool), np.array([[True, False]]), np.zeros((1, 2), bool)
    missed, whole = (background_of([[0.1, 0.1]], untracked_share=0.25) for _ in range(2))
    for background, periods in ((missed, (3, 2)), (whole, (1, 1, 1, 1, 1))):
        for count in periods:
            background.observe(frame_of(seen, parked), count)
    assert missed.probabilities(2) == pytest.approx(whole.probabilities(2), rel=1e-5)
    missed.observe(frame_of(hidden, hidden), 4)
    for _ in range(4):
        whole.observe(frame_of(hidden, hidden))
    assert missed.probabilities(2) == pytest.approx(whole.probabilities(2), rel=1e-5)
    assert missed.hidden_s == pytest.approx(np.full((1, 2), 0.4))


def test_a_removed_wall_is_forgotten():
    background = background_of([[0.9]], 0.99)
    for _ in range(1000):
        background.observe(frame_of(np.ones((1, 1), bool), np.zeros((1, 1), bool)))
    frames = 1 / (1 - math.exp(-0.1 / 5.0))
    assert background.probabilities(0)[0, 0, 0] == pytest.approx(0.9 * MAP_FRAMES / (MAP_FRAMES + frames), rel=1e-5)


def test_outside_the_map_a_return_is_background_until_its_cell_was_open_and_again_after_it_stood_there():
    background = background_of(np.full((5, 5), 0.1), OUTSIDE_MAP)
    seen, empty = np.ones((5, 5), bool), np.zeros((5, 5), bool)
    wall = empty.copy()
    wall[0] = True
    assert background.explained.all()
    background.observe(frame_of(seen, wall))
    assert background.explained[:2].all()  # the wall and its neighbours
    assert not background.explained[2:].any()
    noisy = np.roll(wall, 1, axis=0)
    for _ in range(20):
        background.observe(frame_of(seen, noisy))
    assert background.explained[:2].all()
    assert background.probabilities(0)[0, 1].min() > 0.7
    parked = wall.copy()
    parked[4] = True
    for _ in range(300):
        background.observe(frame_of(seen, parked))
    assert background.explained[3:].all()
    assert not background.explained[2].any()


# Residence


def cells_at(*cells):
    occupied = np.zeros((5, 5), bool)
    for cell in cells:
        occupied[cell] = True
    return occupied


def test_the_age_of_a_return_continues_in_a_neighbour_cell_and_restarts_elsewhere():
    ages = np.full((5, 5), NOT_OCCUPIED)
    for occupied in (cells_at((1, 1)), cells_at((1, 2)), cells_at((1, 2), (4, 4))):
        ages = next_ages(ages, occupied, oldest=10)
    assert (ages[1, 2], ages[4, 4]) == (2, 0)
    assert (ages == NOT_OCCUPIED).sum() == 23
    assert next_ages(ages, cells_at((1, 2)), oldest=2)[1, 2] == 2
    late = next_ages(ages, cells_at((1, 2), (0, 4)), oldest=10, periods=3)
    assert (late[1, 2], late[0, 4]) == (5, 0)


def test_the_life_table_counts_returns_in_place_in_visible_cells():
    seen, hidden = np.ones((5, 5), bool), np.zeros((5, 5), bool)
    shown = [frame_of(seen, cells_at((1, 1))), frame_of(seen, cells_at((1, 1))), frame_of(hidden, cells_at())]
    table = fit_residence([shown] * 100, lambda: lambda frame: np.ones((5, 5), bool), (3, 3), 0.2)
    known = 1.0 / (1.0 + PRIOR_RETURNS / 100)
    assert table[0] == pytest.approx([known, known, 0.0])  # after two steps nothing is seen: the prior stands
    assert table[1] == pytest.approx([known, 0.0, 0.0])


def test_life_table_is_read_from_the_age_and_from_the_time_since_last_seen():
    table = np.array([[1.0, 0.5, 0.2], [0.9, 0.8, 0.7]], np.float32)
    assert probability_in_place(table, np.array([0, 5]), unseen=np.array([0, 0]), steps=3) == pytest.approx(
        np.array([[1.0, 0.5, 0.2, 0.2], [0.9, 0.8, 0.7, 0.7]])
    )
    assert probability_in_place(table, np.array([0]), unseen=np.array([1]), steps=1) == pytest.approx(
        np.array([[0.5, 0.2]])
    )


# Existence


def test_existence_follows_bayes_rule():
    assert existence_when_detected(0.5, 0.9, 0.1) == pytest.approx(0.45 / (0.45 + 0.05))
    assert existence_when_missed(0.5, 0.9) == pytest.approx(0.05 / (0.05 + 0.5))


def test_a_miss_of_a_hidden_object_is_uninformative():
    assert existence_when_missed(0.7, 0.0) == 0.7
