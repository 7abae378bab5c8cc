"""Kinds of cells (static, ring, dynamic), and the regions and bands of strata."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import binary_dilation

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.evaluation.scoring.strata import (
    AGES_S,
    CELL_KINDS,
    STRATA,
    STRATA_WITH_TRUTH,
    SUMS_OF_REGIONS,
    THRESHOLD_OF,
    LastSeen,
    cell_kinds_of,
    region_maps_of,
)

GRID = GridSpec(7, 1.0)
NOTHING = np.zeros((0, 2), np.float32)


def frame(visible, occupied, pose=SE2()):  # noqa: B008
    return GridFrame(0, visible, occupied & visible, pose, NOTHING, NOTHING, np.zeros(0, np.uint8))


def frames_with_cell_occupied(times, of, cell=(3, 3)):
    for i in range(of):
        occupied = np.zeros(GRID.shape, bool)
        occupied[cell] = i < times
        yield frame(np.ones(GRID.shape, bool), occupied)


def names(cell_kinds):
    return np.array(CELL_KINDS)[cell_kinds]


def test_static_is_occupied_in_more_than_half_of_the_frames():
    assert names(cell_kinds_of(frames_with_cell_occupied(3, 5), GRID, SE2()))[3, 3] == "static"
    assert (names(cell_kinds_of(frames_with_cell_occupied(2, 4), GRID, SE2())) == "dynamic").all()


def test_the_half_is_of_the_frames_in_which_the_cell_is_visible():
    seen_once = np.zeros(GRID.shape, bool)
    seen_once[3, 3] = True
    frames = [frame(seen_once, seen_once), *(frame(~seen_once, ~np.ones(GRID.shape, bool)) for _ in range(9))]
    assert names(cell_kinds_of(frames, GRID, SE2()))[3, 3] == "static"


def test_the_ring_is_the_eight_neighbours():
    kind_names = names(cell_kinds_of(frames_with_cell_occupied(1, 1), GRID, SE2()))
    assert (kind_names[2:5, 2:5] != "ring").sum() == 1
    assert (kind_names == "ring").sum() == 8
    assert (kind_names == "dynamic").sum() == 49 - 9


def test_the_ring_does_not_wrap_round_the_grids_edge():
    kind_names = names(cell_kinds_of(frames_with_cell_occupied(1, 1, cell=(0, 0)), GRID, SE2()))
    assert (kind_names == "ring").sum() == 3


def test_frames_with_another_pose_do_not_count():
    walls = np.ones(GRID.shape, bool)
    elsewhere = [frame(walls, walls, SE2(1.0, 0.0, 0.0)) for _ in range(5)]
    here = list(frames_with_cell_occupied(0, 2))
    assert (names(cell_kinds_of(elsewhere + here, GRID, SE2())) == "dynamic").all()


@given(st.lists(st.lists(st.booleans(), min_size=49, max_size=49), min_size=1, max_size=5))
def test_cell_kinds_agree_with_a_dilation(planes):
    occupied = [np.array(plane).reshape(GRID.shape) for plane in planes]
    cell_kinds = cell_kinds_of((frame(np.ones(GRID.shape, bool), o) for o in occupied), GRID, SE2())
    static = np.mean(occupied, axis=0) > 0.5
    assert np.array_equal(cell_kinds == CELL_KINDS.index("static"), static)
    assert np.array_equal(cell_kinds == CELL_KINDS.index("dynamic"), ~binary_dilation(static, np.ones((3, 3))))


def test_strata_without_truth_are_first_so_their_indices_agree():
    assert STRATA_WITH_TRUTH[: len(STRATA)] == STRATA


def test_every_cell_is_in_exactly_one_band():
    def regions(prefix):
        return SUMS_OF_REGIONS[[i for i, name in enumerate(STRATA_WITH_TRUTH) if name.startswith(prefix)]]

    whole = dict(zip(STRATA_WITH_TRUTH, SUMS_OF_REGIONS, strict=True))
    ages = [name for name in STRATA_WITH_TRUTH if name.startswith("occluded ") and name.endswith("s")]
    assert len(ages) == len(AGES_S) + 1
    assert np.array_equal(sum(whole[name] for name in ages), whole["occluded"])
    assert np.array_equal(regions("visible ").sum(axis=0), whole["visible"])
    assert (whole["visible"] + whole["occluded"] == 1).all()


def test_open_cells_are_in_the_stratum_in_motion_so_that_false_alarms_anywhere_count_there():
    whole = dict(zip(STRATA_WITH_TRUTH, SUMS_OF_REGIONS, strict=True))
    assert np.array_equal(whole["dynamic"], whole["in-motion"] + whole["standing"])
    assert whole["in-motion"].sum() == 2 * whole["standing"].sum() > 0


def test_bands_use_the_threshold_of_the_whole_stratum_all_others_their_own():
    assert {THRESHOLD_OF[name] for name in STRATA_WITH_TRUTH} == {*STRATA, "occluded"}
    assert THRESHOLD_OF["visible 5-10 m"] == "visible"
    assert THRESHOLD_OF["occluded over 4 s"] == "occluded"


def test_the_range_of_a_cell_is_that_to_the_nearest_sensor():
    grid = GridSpec(20, 1.0, (0.0, 0.0))
    cell_kinds = np.full(grid.shape, CELL_KINDS.index("dynamic"), np.uint8)
    corners = (
        region_maps_of(cell_kinds, grid, np.array([[0.0, 0.0], [20.0, 20.0]], np.float32)).visible - 3 * cell_kinds
    )
    assert corners[0, 0] == corners[19, 19] == 0
    assert corners[6, 5] == corners[14, 15] == 1
    assert corners[0, 19] == 2


def test_a_cells_age_is_the_time_since_it_was_last_seen():
    last_seen = LastSeen()
    seen = np.zeros(GRID.shape, bool)
    seen[0, :5] = True
    for stamp_ns, columns in ((0, 5), (2_000_000_000, 4), (3_000_000_000, 3), (4_000_000_000, 2), (4_500_000_000, 1)):
        now = seen.copy()
        now[0, columns:] = False
        last_seen.add(GridFrame(stamp_ns, now, now, SE2(), NOTHING, NOTHING, np.zeros(0, np.uint8)))
    bands = last_seen.bands(5_000_000_000)
    assert bands[0, :6].tolist() == [0, 1, 2, 3, 4, 4], "ages 0.5, 1, 2, 3 and 5 s, and never"
