"""The state of a tracker follows its stream: a window that moves, maps at their places, and frames that were missed."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from gridtrack.common.geometry import SE2
from gridtrack.common.grid import GridSpec, Shift, rolled
from gridtrack.trackers.contract import StreamSpec
from gridtrack.trackers.recurrent.conv_lstm import ConvLSTMTracker
from gridtrack.trackers.recurrent.convgru_tracker import DilatedConvGRUTracker
from gridtrack.trackers.recurrent.deep_tracking_rnn import DeepTrackingRNN, DeepTrackingRNNTracker
from gridtrack.trackers.recurrent.network import as_cells, as_tensor, map_state, tensors_of
from gridtrack.trackers.recurrent.network_tracker import MOST_MISSED
from gridtrack.trackers.recurrent.transfer import PastStates
from tests.trackers.recurrent.sources import Drive, convgru, fit, forecast_of, frame_of, rnn, trained

PERIOD_S = 0.25
NO_MAP = {"static_gates": ()}


def tracker_of(network, place=None):
    """The tracker with a trained network with maps at `place`."""
    kind = DeepTrackingRNNTracker if isinstance(network, DeepTrackingRNN) else DilatedConvGRUTracker
    options = kind.Options()
    stream = StreamSpec(GridSpec(network.size, 0.5), PERIOD_S)
    return kind(stream, options, kind.inference_for(network, stream, options), place)


def frame(planes, row=0, column=0, number=0):
    """A frame with the `planes` (2, M, M), with its window at a cell of the world."""
    visible, occupied = planes
    return frame_of(visible, np.logical_and(visible, occupied), stamp_s=number * PERIOD_S, row=row, column=column)


def random_world(frames, size):
    return np.random.default_rng(5).random((frames, 2, size, size)) < 0.4


@pytest.mark.parametrize(
    ("build", "reach"),
    [(lambda n: convgru(n, **NO_MAP), 7), (lambda n: convgru(n, cell="plain", **NO_MAP), 7), (rnn, 5)],
    ids=["convgru", "plain", "rnn"],
)
@pytest.mark.parametrize("windows", [[(0, 0), (1, 50)], [(51, 0), (0, 1)]])
def test_a_window_that_moves_has_the_state_of_one_that_held_every_frame_from_the_start(build, reach, windows):
    size, held = 97, 148
    world = random_world(len(windows), held)
    moving, standing = tracker_of(build(size)), tracker_of(build(held))
    far = np.ones((held, held), bool)
    for planes, (row, column) in zip(world, windows, strict=True):
        inside = (slice(row, row + size), slice(column, column + size))
        moving.update(frame(planes[:, *inside], row, column))
        seen = np.zeros_like(planes)
        seen[:, *inside] = planes[:, *inside]
        standing.update(frame(seen))
        for axis, at in enumerate((row, column)):
            for border in (at, at + size):
                near = slice(max(border - reach * len(windows) - 8, 0), border + reach * len(windows) + 8)
                far[(near, slice(None))[:: 1 - 2 * axis]] = False
    row, column = windows[-1]
    last = (slice(row, row + size), slice(column, column + size))
    found, expected = moving.predict(0).occupancy[0], standing.predict(0).occupancy[0, *last]
    first = np.zeros((held, held), bool)
    first[windows[0][0] : windows[0][0] + size, windows[0][1] : windows[0][1] + size] = True
    for compared in (far & first, far & ~first):
        assert compared[last].sum() > 50, "cells that stayed, and cells that came in"
        np.testing.assert_allclose(found[compared[last]], expected[compared[last]], rtol=0, atol=2e-5)


@pytest.mark.parametrize("settings", [{}, {"static_gates": ("candidate",)}, {"cell": "plain"}])
@pytest.mark.parametrize("place", [None, SE2(-3.0, 2.0)])
def test_the_maps_of_a_network_stay_at_their_place_in_the_world(settings, place):
    size = 21
    at = Shift(0, 0) if place is None else Shift(rows=-4, columns=6)
    first, second = Shift(*at), Shift(at.rows + 3, at.columns - 30)
    nothing = np.zeros((2, size, size))
    planes = random_world(1, size)[0]
    moving = tracker_of(convgru(size, **settings), place)
    for _ in range(2):
        moving.reset(0)
        moving.update(frame(planes))
        expected = tracker_of(with_moved_maps(convgru(size, **settings), first))
        expected.update(frame(planes))
        np.testing.assert_allclose(moving.predict(3).occupancy, expected.predict(3).occupancy, rtol=0, atol=1e-6)
        moving.update(frame(nothing, row=3, column=-30))
        expected = tracker_of(with_moved_maps(convgru(size, **settings), second))
        expected.state = moving.network.initial()
        moving.state = moving.network.initial()
        np.testing.assert_allclose(moving.predict(3).occupancy, expected.predict(3).occupancy, rtol=0, atol=1e-6)


def with_moved_maps(network, shift):
    """The network with its maps rolled, the mean outside."""
    with torch.no_grad():
        for layer in network.layers:
            for bias in layer.biases.values():
                if bias.shape[-1] > 1:
                    mean = bias.mean(dim=(1, 2), keepdim=True).numpy()
                    bias.copy_(torch.from_numpy(rolled(bias.numpy(), shift, mean)))
    return network


def test_a_forecast_does_not_change_the_state_of_a_window_that_moves():
    size = 33
    world = random_world(6, size)
    often, once = (tracker_of(convgru(size)) for _ in range(2))
    for column, planes in enumerate(world):
        often.update(frame(planes, column=column))
        often.predict(4)
        once.update(frame(planes, column=column))
    assert np.array_equal(often.predict(2).occupancy, once.predict(2).occupancy)


def test_reset_forgets_where_the_window_was():
    size = 21
    network = convgru(size)
    used, fresh = (tracker_of(network, SE2(2.0, 0.0)) for _ in range(2))
    used.update(frame(random_world(1, size)[0], column=9))
    used.reset(0)
    assert np.array_equal(used.predict(2).occupancy, fresh.predict(2).occupancy)


def test_a_state_that_was_rolled_lies_in_memory_as_one_that_a_convolution_made():
    state = torch.randn(1, 3, 5, 5).contiguous(memory_format=torch.channels_last)
    again = as_tensor(as_cells(state))
    assert again.data_ptr() == state.data_ptr()
    assert again.stride() == state.stride()
    assert torch.cat([again, again], dim=1).is_contiguous(memory_format=torch.channels_last)


def test_a_nested_state_keeps_its_place_in_the_world_and_cells_beyond_it_are_unseen(tmp_path):
    card = tmp_path / "drive.toml"
    fit(ConvLSTMTracker, card, [Drive()], layers=2, channels=3)
    tracker = trained(ConvLSTMTracker, card, Drive())
    forecast_of(tracker, Drive(5, start=30), 0)
    rolled = tracker.network.rolled(tracker.state, (0, 2), 5)
    unseen = map_state(torch.from_numpy, tracker.network.unseen(5))
    assert len(list(tensors_of(rolled))) == 4
    for old, new, fill in zip(*map(tensors_of, (tracker.state, rolled, unseen)), strict=True):
        assert torch.equal(new[..., :-2], old[..., 2:])
        assert torch.equal(new[0, :, 3, -1], fill)
    nothing = np.zeros((2, 12, 12))
    tracker.update(frame(nothing, number=5, column=99))
    never = trained(ConvLSTMTracker, card, Drive())
    for t in range(6):
        never.update(frame(nothing, number=t))
    centre = np.s_[:, 4:9, 4:9]
    np.testing.assert_allclose(tracker.predict(0).occupancy[centre], never.predict(0).occupancy[centre], atol=1e-5)


def test_the_past_states_of_a_tracker_are_in_the_window_of_its_last_frame():
    size = 12
    tracker = tracker_of(rnn(size))
    past, kept = PastStates(tracker), []
    for number, planes in enumerate(random_world(6, size)):
        past.update(frame(planes, column=2 * number, number=number))
        kept.append(tracker.state[0][0].clone())
    assert past.before(6) is None
    for lead in range(6):
        ((found,),), earlier = past.before(lead), kept[-1 - lead]
        assert torch.equal(found[..., : size - 2 * lead], earlier[..., 2 * lead :])
        if lead:
            ((unseen,),) = tracker.network.unseen(6 - lead)
            assert np.array_equal(found[0, :, 3, -1].numpy(), unseen)


def forecast_after(frames):
    tracker = tracker_of(convgru())
    for one in frames:
        tracker.update(one)
    return tracker.predict(3).occupancy


def test_missed_frames_are_steps_without_input():
    stream = [frame(planes, number=k) for k, planes in enumerate(random_world(8, 12))]
    emptied = [frame(np.zeros((2, 12, 12)), number=k) if k in (2, 3, 6) else f for k, f in enumerate(stream)]
    received = [f for k, f in enumerate(stream) if k not in (2, 3, 6)]
    np.testing.assert_array_equal(forecast_after(received), forecast_after(emptied))
    assert abs(forecast_after(received) - forecast_after(stream)).max() > 1e-3


def test_a_tracker_that_is_too_slow_for_its_stream_makes_up_for_a_bounded_number_of_frames():
    first, last = random_world(2, 12)
    late, near = (frame(last, number=k) for k in (3 * MOST_MISSED, MOST_MISSED + 1))
    np.testing.assert_array_equal(forecast_after([frame(first), late]), forecast_after([frame(first), near]))
