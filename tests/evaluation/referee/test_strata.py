"""The regions and bands of strata, and the time since a cell was seen."""

import numpy as np

from gridtrack.common.grid import GridSpec
from gridtrack.evaluation.referee.strata import (
    CELL_KINDS,
    STRATA,
    STRATA_WITH_TRUTH,
    THRESHOLD_OF,
    LastSeen,
    region_maps_of,
)

from scenes.scored_cells import frame


def test_strata_without_truth_are_first_so_their_indices_agree():
    assert STRATA_WITH_TRUTH[: len(STRATA)] == STRATA


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
    for stamp_ns, columns in ((0, 5), (2_000_000_000, 4), (3_000_000_000, 3), (4_000_000_000, 2), (4_500_000_000, 1)):
        seen = np.zeros((7, 7))
        seen[0, :columns] = True
        last_seen.add(frame(seen, seen, stamp_ns), 1.0)
    bands = last_seen.bands(5_000_000_000)
    assert bands[0, :6].tolist() == [0, 1, 2, 3, 4, 4], "ages 0.5, 1, 2, 3 and 5 s, and never"
