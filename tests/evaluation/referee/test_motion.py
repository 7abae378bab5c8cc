"""Parts of the dynamic cells: in motion, standing, open."""

import numpy as np
import pytest

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec
from gridtrack.common.scan import Scan
from gridtrack.common.scene import Scene, SceneObject
from gridtrack.evaluation.referee.kinds import KindsOfWindow, Regions
from gridtrack.evaluation.referee.motion import ObservedMotion, parts_of
from gridtrack.evaluation.referee.referee import moments
from gridtrack.evaluation.referee.strata import CELL_KINDS, PARTS
from gridtrack.recordings.observation import Observation
from gridtrack.recordings.stream import open_stream

from scenes import scored_cells
from scenes.drives import box

GRID = GridSpec(7, 0.25, (0.0, 0.0))
EVERYWHERE = np.ones(GRID.shape, bool)
FAST, SLOW = 0.4, 0.2
"""Speeds on both sides of the limit, m/s."""


def cells(*marked):
    mask = np.zeros(GRID.shape, bool)
    for row, column in marked:
        mask[row, column] = True
    return mask


def frame(*occupied, visible=EVERYWHERE, at_s=0.0):
    return scored_cells.frame(visible, cells(*occupied), round(at_s * 1e9))


class Frames(list):
    """A FrameSource of frames four times a second."""

    grid, period_s = GRID, 0.25


def parts_of_the_last(*observations):
    motion = ObservedMotion(Frames())
    last = [motion.of(one) for one in observations][-1]
    return parts_of(last.among(observations[-1], GRID), observations[-1].frame.occupied, EVERYWHERE, GRID)


def motion_of_the_last(*frames):
    return parts_of_the_last(*map(Observation, frames))


def drawn(motion):
    return ["".join(PARTS[part][0] for part in row) for row in motion]


def test_cells_within_half_a_metre_of_a_return_in_motion_and_of_one_at_rest_by_hand():
    # cells of 0.25 m: half a metre is two cells along an axis, and one diagonally (0.35 m), but not (1, 2): 0.56 m
    motion = parts_of(cells((1, 1)), cells((1, 1), (4, 4)), EVERYWHERE, GRID)
    assert drawn(motion) == [
        "iiioooo",
        "iiiiooo",
        "iiiosoo",
        "oiossso",
        "oosssss",
        "ooossso",
        "oooosoo",
    ]


def test_near_both_a_cell_is_in_motion_and_only_dynamic_cells_have_a_part():
    dynamic = EVERYWHERE.copy()
    dynamic[:, 0] = False
    motion = parts_of(cells((3, 1)), cells((3, 1), (3, 3), (3, 0)), dynamic, GRID)
    assert drawn(motion)[3] == "oiiisso", "the return at column 0 is not in a dynamic cell"
    assert not motion[:, 0].any()


def test_a_return_is_in_motion_where_its_cell_was_seen_free_one_second_before():
    before = [frame((0, 0), at_s=0.25 * k) for k in range(4)]
    motion = motion_of_the_last(*before, frame((0, 0), (5, 5), at_s=1.0))
    assert (PARTS[motion[0, 0]], PARTS[motion[5, 5]]) == ("standing", "in-motion")


@pytest.mark.parametrize("neighbour", [(5, 5), (4, 4), (4, 5), (5, 4), (6, 6)])
def test_a_return_in_or_beside_a_cell_that_was_occupied_one_second_before_stands(neighbour):
    """Whatever was seen there since."""
    before = [frame(neighbour), *(frame(at_s=0.25 * k) for k in (1, 2, 3))]
    assert PARTS[motion_of_the_last(*before, frame((5, 5), at_s=1.0))[5, 5]] == "standing"


@pytest.mark.parametrize("unseen", [(5, 5), (4, 4), (5, 6)])
def test_a_cell_that_was_hidden_one_second_before_with_its_neighbours_is_not_known_to_have_been_free(unseen):
    before = [frame(visible=~cells(unseen)), *(frame(at_s=0.25 * k) for k in (1, 2, 3))]
    assert PARTS[motion_of_the_last(*before, frame((5, 5), at_s=1.0))[5, 5]] == "standing"


@pytest.mark.parametrize("border", [(0, 3), (6, 3), (3, 0), (3, 6)])
def test_a_return_at_the_border_has_a_neighbour_outside_the_window_and_is_not_called_in_motion(border):
    before = [frame(at_s=0.25 * k) for k in range(4)]
    assert PARTS[motion_of_the_last(*before, frame(border, at_s=1.0))[border]] == "standing"


def test_nothing_is_in_motion_in_the_first_second_of_a_recording():
    assert PARTS[motion_of_the_last(frame(), frame((5, 5), at_s=0.25))[5, 5]] == "standing"


def test_the_second_before_a_stretch_is_read_from_its_recording(record):
    recording = record(seconds=8)
    whole = open_stream(recording)
    dynamic = Regions(whole.grid, KindsOfWindow(np.full(whole.grid.shape, CELL_KINDS.index("dynamic"), np.uint8)))
    first = round(3.0 / whole.period_s)
    expected = [moment.target.motion for moment in moments(whole, dynamic)][first:]
    part = open_stream(f"{recording}@3s-")
    found = [moment.target.motion for moment in moments(part, dynamic)]
    assert (found[0] == PARTS.index("in-motion")).any()
    assert np.array_equal(found, expected)


def observation(step, *objects, occupied):
    """Objects as (track, x, y): boxes of 0.3 m with the centre there."""
    bodies = tuple(SceneObject(track, 0, SE2(x, y), box(-0.15, -0.15, 0.3, 0.3)) for track, x, y in objects)
    observed = frame(*occupied, at_s=0.25 * step)
    scan = Scan(observed.stamp_ns, np.zeros(0, np.float32), 0.0, 0.1, 0.0, 9.0, scene=Scene((), 0, bodies))
    return Observation(observed, (scan,), (SE2(),))


@pytest.mark.parametrize(("speed", "part"), [(FAST, "in-motion"), (SLOW, "standing")])
def test_with_truth_a_return_is_in_motion_on_an_object_faster_than_a_slow_walk(speed, part):
    steps = [observation(k, (1, 0.9 + 0.25 * k * speed, 0.9), occupied=[(3, 3)]) for k in range(2)]
    assert PARTS[parts_of_the_last(*steps)[3, 3]] == part


def test_with_truth_a_cell_that_was_free_before_stands_if_its_object_does():
    steps = [observation(k, (1, 0.9, 0.9), occupied=[(3, 3)] if k == 4 else []) for k in range(5)]
    assert PARTS[parts_of_the_last(*steps)[3, 3]] == "standing"


def test_with_truth_a_return_belongs_to_the_nearest_outline():
    # the pedestrian at column 2 walks past one who stands at column 4
    steps = [
        observation(k, (1, 0.5, 0.8 + 0.25 * k * FAST), (2, 1.2, 0.9), occupied=[(3, 2), (3, 4)]) for k in range(2)
    ]
    motion = parts_of_the_last(*steps)
    assert drawn(motion)[3] == "iiiiiss", "in motion up to half a metre from the one who walks"


def test_with_truth_a_return_far_from_every_outline_stands():
    steps = [observation(k, (1, 0.4 + 0.25 * k * FAST, 0.4), occupied=[(1, 1), (6, 6)]) for k in range(2)]
    motion = parts_of_the_last(*steps)
    assert (PARTS[motion[1, 1]], PARTS[motion[6, 6]]) == ("in-motion", "standing")
