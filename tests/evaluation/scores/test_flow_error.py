"""Flow errors: by hand, and against a loop over every cell."""

import math
from dataclasses import replace

import numpy as np
import pytest

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec
from gridtrack.common.scan import Scan
from gridtrack.common.scene import Scene, SceneObject
from gridtrack.evaluation.referee.motion import FollowedBodies
from gridtrack.evaluation.referee.strata import PARTS, STRATA_WITH_TRUTH
from gridtrack.evaluation.referee.targets import (
    HIDDEN_OCCUPIED,
    SEEN_FREE,
    SEEN_OCCUPIED,
    Target,
    TrueFlow,
    target_of,
)
from gridtrack.evaluation.scores.flow_error import FLOW_ERROR, FLOW_STRATA
from gridtrack.recordings.observation import Observation

from scenes.scored_cells import DYNAMIC_CELL, counted, facts_of, frame, region_maps, scored

GRID = GridSpec(8, 1.0, (0.0, 0.0))
POST = np.array([(-0.2, -0.2), (0.2, -0.2), (0.2, 0.2), (-0.2, 0.2)], np.float32)
MAPS = region_maps(np.full(GRID.shape, DYNAMIC_CELL), STRATA_WITH_TRUTH)


def scene(*bodies):
    return Scene((), 0, tuple(SceneObject(track, 0, pose, POST) for track, pose in bodies))


def motions(*scenes, period_ns=500_000_000):
    followed = FollowedBodies()
    return [followed.motions(i * period_ns, one) for i, one in enumerate(scenes)][-1]


def flow_sums(velocity, targets):
    """Cells, cells with a velocity, errors and true speeds (S, K)."""
    occupancy = np.zeros((len(targets), *GRID.shape), np.float32)
    strata, sums = counted(FLOW_ERROR, scored(occupancy, targets, MAPS, velocity=velocity), has_truth=True)
    assert strata == FLOW_STRATA
    return tuple(sums[name] for name in ("cells", "given", "error", "speed"))


def test_a_body_that_turns_moves_each_of_its_points_differently():
    bodies = motions(scene((1, SE2(4.0, 4.0, 0.0))), scene((1, SE2(4.0, 5.0, 0.1))))
    points = np.array([(4.0, 5.0), (6.0, 5.0)])
    found = bodies.velocities(np.zeros(2, int), points, SE2())
    ahead = np.array([2 - 2 * math.cos(0.1), 2 * math.sin(0.1)])  # the second point lay two metres ahead of the first
    assert found == pytest.approx(np.array([(0.0, 2.0), (ahead[0] / 0.5, 2.0 + ahead[1] / 0.5)]))


def test_velocities_are_along_the_axes_of_a_window_that_is_turned():
    bodies = motions(scene((1, SE2(4.0, 4.0))), scene((1, SE2(5.0, 4.0))))
    found = bodies.velocities(np.zeros(1, int), np.array([(0.0, 0.0)]), SE2(5.0, 4.0, math.pi / 2))
    assert found == pytest.approx(np.array([(0.0, -2.0)]))


def test_a_body_that_is_new_has_no_velocity_and_no_speed():
    bodies = motions(scene((1, SE2(1.0, 1.0))), scene((1, SE2(1.0, 1.0)), (2, SE2(3.0, 3.0))))
    assert bodies.speeds.tolist() == [0.0, 0.0]
    assert np.isnan(bodies.velocities(np.array([1]), np.zeros((1, 2)), SE2())).all()


def observed_target():
    """Three bodies at 2 m/s: one in view, one hidden, one new; and a return that is of none."""
    then, now = [(1, SE2(2.5, 0.5)), (2, SE2(6.5, 5.5))], [(1, SE2(2.5, 1.5)), (2, SE2(5.5, 5.5)), (3, SE2(0.5, 6.5))]
    visible, occupied = np.zeros((2, *GRID.shape), bool)
    visible[:4], visible[6, 0] = True, True
    occupied[1, 2] = occupied[3, 7] = occupied[6, 0] = True
    scan = Scan(0, np.zeros(0, np.float32), 0.0, 0.1, 0.0, 9.0, scene=scene(*now))
    observation = Observation(frame(visible, occupied), (scan,), (SE2(),))
    in_motion = np.full(GRID.shape, PARTS.index("in-motion"), np.uint8)
    return target_of(observation, GRID, ("pedestrian",), in_motion, motions(scene(*then), scan.scene))


def test_the_true_flow_has_the_occupied_cells_of_bodies_that_were_there_before():
    target = observed_target()
    assert target.state[5, 5] == HIDDEN_OCCUPIED
    flow = target.flow()
    assert dict(zip(flow.cells.tolist(), flow.velocity.tolist(), strict=True)) == {
        1 * 8 + 2: pytest.approx([0.0, 2.0]),
        5 * 8 + 5: pytest.approx([-2.0, 0.0]),
    }


def test_errors_by_hand():
    """The pedestrian in view is forecast 1 m/s too slow and 1 m/s aside, of the hidden one nothing is known."""
    velocity = np.full((1, 2, *GRID.shape), np.nan, np.float32)
    velocity[0, :, 1, 2] = 1.0, 1.0
    velocity[0, :, 3, 7] = 50.0, 0.0
    cells, given, error, speed = flow_sums(velocity, [observed_target()])
    assert FLOW_STRATA == ("dynamic", "in-motion", "occluded")
    assert cells.tolist() == [[1, 1, 1]]
    assert given.tolist() == [[1, 1, 0]]
    assert error == pytest.approx(np.array([[math.sqrt(2), math.sqrt(2), 0.0]]))
    assert speed == pytest.approx(np.array([[2.0, 2.0, 0.0]]))


def test_velocities_of_step_0_alone_say_nothing_of_later_steps():
    targets = [observed_target()] * 3
    cells, given, _, _ = flow_sums(np.zeros((2, *GRID.shape), np.float32), targets)
    assert cells[:, 0].tolist() == [1, 1, 1]
    assert given[:, 0].tolist() == [1, 0, 0]


def test_cells_count_from_the_first_forecast_with_velocities_on():
    targets, occupancy = [observed_target()] * 2, np.zeros((2, *GRID.shape), np.float32)
    without, with_ = (
        scored(occupancy, targets, MAPS, velocity=one) for one in (None, np.zeros((2, *GRID.shape), np.float32))
    )
    facts = facts_of(without, has_truth=True)
    memory = FLOW_ERROR.new_memory(facts)
    counts = [FLOW_ERROR.count(one, facts, memory) for one in (without, with_, without)]
    assert counts[0] is None
    assert [one[0, 0, :2].tolist() for one in counts[1:]] == [[1, 1], [1, 0]]


def test_without_ground_truth_no_cell_has_a_velocity():
    assert Target.of_frame(frame(*np.ones((2, *GRID.shape)))).flow().cells.size == 0


def test_random_flows_agree_with_a_loop_over_every_cell():
    rng = np.random.default_rng(0)
    steps = 3
    velocity = rng.normal(size=(steps + 1, 2, *GRID.shape)).astype(np.float32)
    velocity[rng.random(velocity.shape) < 0.2] = np.nan
    targets, expected = [], np.zeros((4, steps + 1, len(FLOW_STRATA)))
    for n in range(steps + 1):
        state = rng.choice([SEEN_FREE, SEEN_OCCUPIED, HIDDEN_OCCUPIED], GRID.shape).astype(np.uint8)
        part = rng.integers(0, 3, GRID.shape).astype(np.uint8)
        cells = np.flatnonzero((state.ravel() != SEEN_FREE) & (rng.random(state.size) < 0.7))
        truth = rng.normal(size=(len(cells), 2))
        flow = TrueFlow(cells, truth)
        observed = frame(state <= SEEN_OCCUPIED, state == SEEN_OCCUPIED)
        targets.append(replace(Target(observed, state, part), flow=lambda flow=flow: flow))
        for cell, (vx, vy) in zip(cells.tolist(), truth.tolist(), strict=True):
            row, column = divmod(cell, 8)
            hidden, standing = state[row, column] == HIDDEN_OCCUPIED, part[row, column] == 1
            own_x, own_y = velocity[n, :, row, column].tolist()
            given = not (math.isnan(own_x) or math.isnan(own_y))
            error = math.hypot(own_x - vx, own_y - vy) if given else 0.0
            for k, name in enumerate(FLOW_STRATA):
                if {"dynamic": not hidden, "in-motion": not hidden and not standing, "occluded": hidden}[name]:
                    expected[:, n, k] += 1, given, error, given * math.hypot(vx, vy)
    cells, given, error, speed = flow_sums(velocity, targets)
    assert np.array_equal(cells, expected[0])
    assert np.array_equal(given, expected[1])
    assert error == pytest.approx(expected[2])
    assert speed == pytest.approx(expected[3])
