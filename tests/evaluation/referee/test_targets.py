"""Targets: the states of cells, and the classes of labelled cells."""

from dataclasses import replace

import numpy as np
import pytest

from gridtrack.common.errors import RecordingError
from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec
from gridtrack.common.scan import Scan
from gridtrack.common.scene import Scene, SceneObject
from gridtrack.evaluation.referee.targets import (
    HIDDEN_FREE,
    HIDDEN_OCCUPIED,
    NOT_SCORED,
    SEEN_FREE,
    SEEN_OCCUPIED,
    Target,
    target_of,
)
from gridtrack.recordings.observation import Observation

from scenes.drives import box
from scenes.scored_cells import frame

GRID = GridSpec(5, 1.0, (0.0, 0.0))
NAMES = ("pedestrian", "static")
NO_MOTION = np.zeros(GRID.shape, np.uint8)


def test_without_truth_only_visible_cells_are_scored():
    visible, occupied = np.zeros((2, 5, 5), bool)
    visible[0], occupied[0, 1] = True, True
    state = Target.of_frame(frame(visible, occupied)).state
    assert state[0].tolist() == [SEEN_FREE, SEEN_OCCUPIED, SEEN_FREE, SEEN_FREE, SEEN_FREE]
    assert (state[1:] == NOT_SCORED).all()


def test_with_truth_hidden_outlines_are_occupied_interiors_not_scored_and_visible_cells_as_observed():
    visible, occupied = np.zeros((2, 5, 5), bool)
    visible[0], occupied[0, 2] = True, True
    scene = Scene((box(0.5, 1.5, 3.9, 3.0),), 1, (SceneObject(7, 0, SE2(4.0, 0.5), box(0.2, -0.2, 0.4, 0.4)),))
    scan = Scan(0, np.zeros(0, np.float32), 0.0, 0.1, 0.0, 9.0, scene=scene)
    target = target_of(Observation(frame(visible, occupied), (scan,), (SE2(),)), GRID, NAMES, NO_MOTION)
    free, seen = SEEN_FREE, SEEN_OCCUPIED
    assert target.state[0].tolist() == [free, free, seen, free, free], "the pedestrian's own cell was seen free"
    assert target.state[1].tolist() == [HIDDEN_OCCUPIED] * 5
    assert target.state[2].tolist() == [HIDDEN_OCCUPIED, *[NOT_SCORED] * 3, HIDDEN_OCCUPIED]
    assert HIDDEN_FREE not in target.state
    assert target.cells.tolist() == np.flatnonzero(target.state == HIDDEN_OCCUPIED).tolist()
    assert set(target.labels.tolist()) == {1}


def fan(labels):
    """As many beams as there are labels, all ending in cell [2, 4] of the grid, seen from [2, 2]."""
    ranges = np.full(len(labels), 2.2, np.float32)
    return Scan(0, ranges, 0.0, 0.01, 0.0, 9.0, labels=np.array(labels, np.uint8))


def seen_by(*fans):
    """The target of a frame in which cell [2, 4] alone is occupied."""
    occupied = np.zeros((5, 5))
    occupied[2, 4] = True
    observation = Observation(frame(np.ones((5, 5)), occupied), fans, (SE2(2.5, 2.1),) * len(fans))
    return target_of(observation, GRID, NAMES, NO_MOTION)


@pytest.mark.parametrize(
    ("labels", "found"),
    [([1, 1, 0], [1]), ([0, 1], [0]), ([255, 255, 1], []), ([255, 1, 1], [1]), ([255, 255], [])],
)
def test_a_cell_has_the_class_of_most_beams_that_end_in_it(labels, found):
    target = seen_by(fan(labels))
    assert target.labels.tolist() == found
    assert target.cells.tolist() == [2 * 5 + 4] * len(found)


def test_beams_of_all_sensors_vote_together():
    assert seen_by(fan([0, 0]), replace(fan([1, 1, 1]), sensor="rear")).labels.tolist() == [1]


def test_a_label_without_a_class_is_refused():
    with pytest.raises(RecordingError, match=r"is class 2 at 0\.000 s, but the recording has 2 classes"):
        seen_by(fan([2]))
