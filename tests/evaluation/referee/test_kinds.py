"""Kinds of cells (static, ring, dynamic), of a sensor at rest and of one that moves."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import binary_dilation

from gridtrack.common.errors import RecordingError
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec
from gridtrack.evaluation.referee import kinds
from gridtrack.evaluation.referee.kinds import BLOCK_NS, TILE_CELLS, ObservedCounts, WorldCells, observed_kinds
from gridtrack.evaluation.referee.strata import CELL_KINDS
from gridtrack.recordings.observation import Observation

from scenes.scored_cells import frame

GRID = GridSpec(7, 1.0)


def kinds_of(frames, window=SE2(), stamp_ns=0):  # noqa: B008
    return observed_kinds(map(Observation, frames), GRID).at(window, stamp_ns)


def names(cell_kinds):
    return np.array(CELL_KINDS)[cell_kinds]


def test_the_half_is_of_the_frames_in_which_the_cell_is_visible():
    seen_once = np.zeros(GRID.shape, bool)
    seen_once[3, 3] = True
    frames = [frame(seen_once, seen_once), *(frame(~seen_once, ~np.ones(GRID.shape, bool)) for _ in range(9))]
    assert names(kinds_of(frames))[3, 3] == "static"


@given(st.lists(st.lists(st.booleans(), min_size=49, max_size=49), min_size=1, max_size=5))
def test_cell_kinds_agree_with_a_dilation(planes):
    occupied = [np.array(plane).reshape(GRID.shape) for plane in planes]
    cell_kinds = kinds_of(frame(np.ones(GRID.shape, bool), o) for o in occupied)
    static = np.mean(occupied, axis=0) > 0.5
    assert np.array_equal(cell_kinds == CELL_KINDS.index("static"), static)
    assert np.array_equal(cell_kinds == CELL_KINDS.index("dynamic"), ~binary_dilation(static, np.ones((3, 3))))


def wall_seen_from(x, wall_x, block=0):
    """A wall of the world along the column at `wall_x`, seen whole in the window at `x`, in a block of time."""
    occupied = np.zeros(GRID.shape, bool)
    column = wall_x - x + 3
    if 0 <= column < 7:
        occupied[:, column] = True
    visible = np.ones(GRID.shape, bool)
    visible[:, column + 1 :] = False
    return frame(visible, occupied, block * BLOCK_NS, SE2(float(x)))


def test_a_wall_that_stays_is_static_in_every_window_that_moves_past_it():
    frames = [wall_seen_from(x, wall_x=2) for x in (-1, 0, 1, 2)]
    assert names(kinds_of(frames, SE2(0.0)))[3].tolist() == WALL_AT_TWO
    assert names(kinds_of(frames, SE2(2.0)))[3].tolist() == WALL_AT_ZERO
    assert (names(kinds_of(frames, SE2(40.0))) == "dynamic").all(), "no window was there"


def test_a_wall_that_the_error_of_the_pose_puts_into_three_cells_in_turn_is_static_in_all_of_them():
    frames = [wall_seen_from(x, wall_x=2 + error) for x, error in zip((-1, 0) * 6, (-1, 0, 1) * 4, strict=True)]
    assert names(kinds_of(frames, SE2(0.0)))[3].tolist() == [*["dynamic"] * 3, "ring", *["static"] * 3]


WALL_AT_TWO = [*["dynamic"] * 4, "ring", "static", "ring"]
WALL_AT_ZERO = [*["dynamic"] * 2, "ring", "static", "ring", *["dynamic"] * 2]


def test_a_wall_that_the_drift_of_minutes_displaces_is_static_where_it_is_seen_at_each_time():
    early = [wall_seen_from(x, 2, block) for block in (0, 1) for x in (-1, 0, 1)]
    late = [wall_seen_from(x, 0, block) for block in (60, 61) for x in (-1, 0, 1)]
    kinds = observed_kinds(map(Observation, [*early, *late]), GRID)
    for block, expected in ((0, WALL_AT_TWO), (1, WALL_AT_TWO), (60, WALL_AT_ZERO), (61, WALL_AT_ZERO)):
        assert names(kinds.at(SE2(), block * BLOCK_NS + 5))[3].tolist() == expected


def test_the_cells_of_a_block_are_judged_by_it_and_the_blocks_before_and_after():
    wall = {block: [wall_seen_from(x, 2, block) for x in (0, 1)] for block in range(5)}
    free = {block: [wall_seen_from(x, 90, block) for x in (0, 1)] for block in range(5)}
    one_in_three = observed_kinds(map(Observation, [*free[0], *wall[1], *free[2]]), GRID)
    assert (names(one_in_three.at(SE2(), BLOCK_NS)) == "dynamic").all(), "seen free before and after"
    others_far = observed_kinds(map(Observation, [*free[0], *wall[2], *free[4]]), GRID)
    assert names(others_far.at(SE2(), 2 * BLOCK_NS))[3].tolist() == WALL_AT_TWO


def test_kinds_so_far_come_from_the_frames_so_far_and_counting_continues():
    frames = [wall_seen_from(x, 2 if block < 3 else 0, block) for block in range(6) for x in (-1, 0, 1)]
    counts = ObservedCounts(GRID)
    for n, one in enumerate(frames, start=1):
        counts.add(Observation(one))
        expected = observed_kinds(map(Observation, frames[:n]), GRID)
        window = SE2(), one.stamp_ns
        assert np.array_equal(counts.kinds().at(*window), expected.at(*window))


def test_all_frames_of_a_sensor_at_rest_count_however_long_it_rests():
    frames = [wall_seen_from(0, 2 if block < 7 else 90, block) for block in range(10)]
    assert names(kinds_of(frames, stamp_ns=9 * BLOCK_NS))[3].tolist() == WALL_AT_TWO


def test_passing_objects_are_not_static_for_a_moving_sensor():
    frames = [wall_seen_from(k % 2, wall_x=2 if k == 5 else 90) for k in range(12)]
    assert (names(kinds_of(frames, SE2(0.0))) == "dynamic").all()


def test_kinds_of_a_turned_window_come_from_the_cells_below_the_centres_of_its_cells():
    frames = [wall_seen_from(x, wall_x=2) for x in (-1, 0, 1, 2)]
    assert np.array_equal(kinds_of(frames, SE2(0.0, 0.0, np.pi / 2)), np.rot90(kinds_of(frames, SE2(0.0))))


@given(row=st.integers(-300, 300), column=st.integers(-300, 300), size=st.integers(1, 200))
def test_values_added_to_cells_of_the_world_are_read_at_the_same_place(row, column, size):
    rng = np.random.default_rng(size)
    values = rng.integers(1, 9, (2, size, size + 3))
    cells = WorldCells(2, np.int32)
    cells.add((row, column), values)
    cells.add((row, column), values)
    assert np.array_equal(cells.read((row, column), (size, size + 3)), 2 * values)
    around = cells.read((row - 5, column - 5), (size + 10, size + 13))
    assert around.sum() == 2 * values.sum()


def test_the_memory_of_a_long_way_is_bounded_and_the_error_has_the_remedy(monkeypatch):
    monkeypatch.setattr(kinds, "MAX_TILES", 2)
    cells = WorldCells(1, np.bool_)
    with pytest.raises(RecordingError, match="name a larger cell with --grid, or import a part of the recording"):
        cells.add((0, 0), np.ones((1, 1, 3 * TILE_CELLS), np.bool_))
