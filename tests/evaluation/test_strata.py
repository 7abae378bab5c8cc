"""Which cells are static, which are their ring, and which are moving."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import binary_dilation

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridFrame, GridSpec
from gridtrack.evaluation.strata import REGIONS, STRATA, SUMS_OF_REGIONS, regions_of

GRID = GridSpec(7, 1.0)
NOTHING = np.zeros((0, 2), np.float32)


def frame(visible, occupied, pose=SE2()):  # noqa: B008
    return GridFrame(0, visible, occupied & visible, pose, NOTHING, NOTHING, np.zeros(0, np.uint8))


def frames_with_cell_occupied(times, of, cell=(3, 3)):
    for i in range(of):
        occupied = np.zeros(GRID.shape, bool)
        occupied[cell] = i < times
        yield frame(np.ones(GRID.shape, bool), occupied)


def names(regions):
    return np.array(REGIONS)[regions]


def test_static_is_occupied_in_more_than_half_of_the_frames():
    assert names(regions_of(frames_with_cell_occupied(3, 5), GRID, SE2()))[3, 3] == "static"
    assert (names(regions_of(frames_with_cell_occupied(2, 4), GRID, SE2())) == "moving").all()


def test_the_half_is_of_the_frames_in_which_the_cell_is_visible():
    seen_once = np.zeros(GRID.shape, bool)
    seen_once[3, 3] = True
    frames = [frame(seen_once, seen_once), *(frame(~seen_once, ~np.ones(GRID.shape, bool)) for _ in range(9))]
    assert names(regions_of(frames, GRID, SE2()))[3, 3] == "static"


def test_the_ring_is_the_eight_neighbours():
    region_names = names(regions_of(frames_with_cell_occupied(1, 1), GRID, SE2()))
    assert (region_names[2:5, 2:5] != "ring").sum() == 1
    assert (region_names == "ring").sum() == 8
    assert (region_names == "moving").sum() == 49 - 9


def test_the_ring_does_not_wrap_round_the_grids_edge():
    region_names = names(regions_of(frames_with_cell_occupied(1, 1, cell=(0, 0)), GRID, SE2()))
    assert (region_names == "ring").sum() == 3


def test_frames_from_elsewhere_say_nothing_about_these_cells():
    walls = np.ones(GRID.shape, bool)
    elsewhere = [frame(walls, walls, SE2(1.0, 0.0, 0.0)) for _ in range(5)]
    here = list(frames_with_cell_occupied(0, 2))
    assert (names(regions_of(elsewhere + here, GRID, SE2())) == "moving").all()


@given(st.lists(st.lists(st.booleans(), min_size=49, max_size=49), min_size=1, max_size=5))
def test_regions_agree_with_a_dilation(planes):
    occupied = [np.array(plane).reshape(GRID.shape) for plane in planes]
    regions = regions_of((frame(np.ones(GRID.shape, bool), o) for o in occupied), GRID, SE2())
    static = np.mean(occupied, axis=0) > 0.5
    assert np.array_equal(regions == REGIONS.index("static"), static)
    assert np.array_equal(regions == REGIONS.index("moving"), ~binary_dilation(static, np.ones((3, 3))))


def test_strata_are_made_of_the_regions_they_name():
    made_of = {
        name: [REGIONS[i] for i in np.nonzero(row)[0]] for name, row in zip(STRATA, SUMS_OF_REGIONS, strict=True)
    }
    assert made_of == {"visible": list(REGIONS), "moving": ["moving"], "static": ["static"]}
