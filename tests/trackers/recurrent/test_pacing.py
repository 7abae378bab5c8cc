"""A network with steps of the same duration at every period: substeps for slow frames, phases for fast ones."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from gridtrack.trackers.recurrent.pacing import PacedNetwork, StepPace
from tests.trackers.recurrent.sources import TRACKERS, convgru, rnn

SIZE = 12


@pytest.mark.parametrize(
    ("period_s", "pace"),
    [
        (0.1, (1, 1)),
        (0.2, (2, 1)),
        (0.05, (1, 2)),
        (1 / 13.5, (1, 1)),
        (1 / 15, (1, 2)),
        (0.14, (1, 1)),
        (0.15, (2, 1)),
    ],
)
def test_a_step_lasts_a_tenth_of_a_second_by_a_factor_of_sqrt_2_at_most(period_s, pace):
    found = StepPace.of(period_s, 0.1)
    assert found == pace
    assert 0.1 / 2**0.5 <= found.step_s(period_s) <= 0.1 * 2**0.5


def test_without_a_duration_a_step_is_a_frame():
    assert StepPace.of(0.37, 0.0) == StepPace() == (1, 1)


@pytest.mark.parametrize("pace", [StepPace(), StepPace(2, 1), StepPace(3, 1), StepPace(1, 2), StepPace(1, 3)])
def test_the_frames_of_a_training_window_lie_at_the_steps_that_take_them_in_a_stream(pace):
    """Twelve steps; the frames are numbered from 1, and 0 is a step without one."""
    frames = np.arange(1, pace.frames(12) + 1, dtype=np.uint8)[:, None]
    steps = pace.steps_of(frames, 12)[:, 0].tolist()
    assert len(steps) == 12
    assert [frame for frame in steps if frame] == frames[:: pace.phases, 0].tolist()
    assert steps[pace.substeps - 1 :: pace.substeps] == frames[:: pace.phases, 0].tolist()
    assert steps[5] == frames[pace.frame_of(5), 0]


def networks(tracker, pace):
    network = convgru(static_gates=()) if tracker is TRACKERS[0] else rnn()
    one = tracker.prepare_inference(network, tracker.Options())
    return one, PacedNetwork(one, pace)


def frames(count):
    draw = torch.Generator().manual_seed(1)
    planes = (torch.rand(count, 1, 2, SIZE, SIZE, generator=draw) < 0.3).float()
    return [plane.contiguous(memory_format=torch.channels_last) for plane in planes]


def run(network, planes, state):
    for x in planes:
        state = network.step(x, state)
    return state


@pytest.mark.parametrize("tracker", TRACKERS)
def test_between_slow_frames_are_steps_without_input(tracker):
    one, substeps = networks(tracker, StepPace(3, 1))
    x = frames(2)
    with torch.inference_mode():
        expected = run(one, [None, None, x[0], None, None, x[1], None, None, None], one.initial(1))
        (found,) = state = run(substeps, [*x, None], substeps.initial())
        assert all(torch.equal(a, b) for a, b in zip(found, expected, strict=True))
        assert torch.equal(substeps.occupancy(state), one.occupancy(one.features(expected)))
    assert all(np.array_equal(a, b) for a, b in zip(substeps.unseen(2)[0], one.unseen(6), strict=True))


@pytest.mark.parametrize("tracker", TRACKERS)
def test_two_phases_alternate_and_each_forecast_is_of_the_state_that_would_take_its_frame(tracker):
    one, phases = networks(tracker, StepPace(1, 2))
    x = frames(5)
    with torch.inference_mode():
        even, odd = (
            run(one, x[0::2], one.initial(1)),
            run(one, x[1::2], one.initial(1)),
        )  # the last frame, number 4, is of the first one
        state = run(phases, x, phases.initial())
        assert torch.equal(phases.occupancy(state), one.occupancy(one.features(even)))
        for step in range(1, 5):
            state = phases.step(None, state)
            own, count = (even, step // 2) if step % 2 == 0 else (odd, (step + 1) // 2)
            expected = run(one, [None] * count, own)
            assert torch.equal(phases.occupancy(state), one.occupancy(one.features(expected))), step
            assert all(torch.equal(a, b) for a, b in zip(state[-1], expected, strict=True))


@pytest.mark.parametrize("tracker", TRACKERS)
def test_a_cell_that_no_frame_has_seen_has_the_state_of_its_phase(tracker):
    """After five frames the older state had two, the newer one three."""
    one, phases = networks(tracker, StepPace(1, 2))
    for found, steps in zip(phases.unseen(5), (2, 3), strict=True):
        assert all(np.array_equal(a, b) for a, b in zip(found, one.unseen(steps), strict=True))
