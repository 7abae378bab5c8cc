"""The trackers of the last frames: pace, moving window, present, samples, training for a site and for any place."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from gridtrack.common.config import validated
from gridtrack.common.errors import WeightsError
from gridtrack.common.grid import GridSpec
from gridtrack.trackers.contract import StreamSpec
from gridtrack.trackers.past_frames.network import PAST_STEPS
from gridtrack.trackers.past_frames.simvp import SimVPTracker
from gridtrack.trackers.past_frames.sogmp import SOGMPTracker
from gridtrack.trackers.recurrent.conv_lstm import ConvLSTMTracker
from gridtrack.trackers.training.weights import read_card
from tests.trackers.recurrent.sources import (
    Drive,
    Walk,
    constant,
    fit,
    forecast_of,
    frame_of,
    log_loss_of,
    randomised,
    trained,
)

TINY = {
    SimVPTracker: {"channels": 2, "hidden": 4, "blocks": 2},
    SOGMPTracker: {"channels": 2, "hidden": 4},
}
BOTH = pytest.mark.parametrize("kind", TINY)
SIZE = 12


def tracker(kind, period_s=0.1, **options):
    """The tracker with random weights, for a stream of 12 x 12 cells of 0.5 m."""
    settings = validated(kind.Options, TINY[kind] | options, "test")
    network = randomised(kind.build(SIZE, settings, 0), 0.2)
    stream = StreamSpec(GridSpec(SIZE, 0.5), period_s)
    return kind(stream, settings, kind.inference_for(network, stream, settings))


def frames(count, *, period_s=0.1, first=0):
    draw = np.random.default_rng(2)
    for t in range(count):
        visible, hit = draw.random((2, SIZE, SIZE)) < 0.4
        if t >= first:
            yield frame_of(visible, visible & hit, stamp_s=t * period_s)


def followed(made, stream, seed=0):
    made.reset(seed)
    for frame in stream:
        made.update(frame)
    return made


def planes(stream):
    return torch.from_numpy(np.stack([[frame.visible, frame.occupied] for frame in stream]).astype(np.float32))


def probabilities(made, past, steps):
    with torch.no_grad():
        return torch.sigmoid(made.network.network.forecast(past[None], steps).logits)[0].numpy()


def test_visible_cells_are_now_as_observed_and_the_others_as_in_the_first_step():
    made = followed(tracker(SimVPTracker), frames(14))
    *_, last = frames(14)
    occupancy = made.predict(3).occupancy
    assert occupancy.shape == (4, SIZE, SIZE)
    assert occupancy.dtype == np.float32
    np.testing.assert_array_equal(occupancy[0][last.visible], last.occupied[last.visible])
    np.testing.assert_array_equal(occupancy[0][~last.visible], occupancy[1][~last.visible])
    np.testing.assert_allclose(occupancy[1:], probabilities(made, planes([*frames(14)][-10:]), 3), atol=1e-6)
    np.testing.assert_allclose(made.predict(0).occupancy, occupancy[:1], atol=1e-6)


def test_before_the_tenth_frame_and_in_missed_frames_nothing_is_visible():
    stream = [*frames(6)]
    made = followed(tracker(SimVPTracker), [*stream[:2], stream[4]])
    past = torch.zeros(PAST_STEPS, 2, SIZE, SIZE)
    past[[-5, -4, -1]] = planes([stream[0], stream[1], stream[4]])
    np.testing.assert_allclose(made.predict(2).occupancy[1:], probabilities(made, past, 2), atol=1e-6)


def test_slow_frames_have_steps_without_a_frame_between_them_and_only_their_own_steps_are_forecast():
    """Frames every 0.2 s make two steps each, the second of which has the frame."""
    made = followed(tracker(SimVPTracker, 0.2, step_s=0.1), frames(7, period_s=0.2))
    past = torch.zeros(PAST_STEPS, 2, SIZE, SIZE)
    past[1::2] = planes([*frames(7)][-5:])
    expected = probabilities(made, past, 6)[1::2]
    np.testing.assert_allclose(made.predict(3).occupancy[1:], expected, atol=1e-6)


def test_of_fast_frames_every_second_one_is_a_step_and_a_forecast_is_of_the_series_that_takes_its_frame():
    made = followed(tracker(SimVPTracker, 0.05, step_s=0.1), frames(23, period_s=0.05))
    x = planes(frames(23))
    older, newer = (probabilities(made, series[-10:], 2) for series in (x[1::2], x[0::2]))
    expected = [older[0], newer[0], older[1]]
    np.testing.assert_allclose(made.predict(3).occupancy[1:], expected, atol=1e-6)


@BOTH
def test_past_frames_move_with_the_window_and_cells_that_come_in_are_unseen(kind):
    """A stream whose window jumps by (1, 2) equals one that saw, all the time, from the last window."""
    before, made, other = [*frames(5)], tracker(kind), tracker(kind)
    moved = frame_of(np.ones((SIZE, SIZE)), np.eye(SIZE), stamp_s=0.5, row=1, column=2)

    def in_last_window(plane):
        found = np.zeros((SIZE, SIZE), bool)
        found[:-1, :-2] = plane[1:, 2:]
        return found

    stayed = [
        frame_of(in_last_window(f.visible), in_last_window(f.occupied), stamp_s=t / 10, row=1, column=2)
        for t, f in enumerate(before)
    ]
    followed(made, [*before, moved]), followed(other, [*stayed, moved])
    np.testing.assert_allclose(made.predict(2).occupancy, other.predict(2).occupancy, atol=1e-6)


def test_futures_are_of_the_seed_and_the_frames_whatever_was_predicted_before():
    made = followed(tracker(SOGMPTracker, samples=3), frames(8), seed=5)
    first = made.predict(2)
    assert first.futures.shape == (3, 3, SIZE, SIZE)
    assert first.futures.dtype == np.float16
    np.testing.assert_allclose(first.futures.astype(np.float32).mean(axis=0), first.occupancy, atol=1e-3)
    assert np.ptp(first.futures[:, 1].astype(np.float32), axis=0).max() > 1e-3
    longer = made.predict(4)
    np.testing.assert_allclose(longer.futures[:, :3], first.futures, atol=1e-3)
    again = followed(tracker(SOGMPTracker, samples=3), frames(8), seed=5).predict(2)
    np.testing.assert_array_equal(again.futures, first.futures)
    other = followed(made, frames(8), seed=6).predict(2)
    assert np.abs(other.occupancy - first.occupancy).max() > 1e-3
    assert followed(tracker(SimVPTracker), frames(3)).predict(1).futures is None


@pytest.mark.parametrize("kind", [*TINY, ConvLSTMTracker])
def test_it_trains_for_any_place_and_goes_on_at_a_site_from_there(kind, tmp_path):
    """The ConvLSTM too: a network with the plain interface and a nested state, without kernels."""
    given = TINY.get(kind, {"layers": 2, "channels": 3})
    general, site = tmp_path / "any/general.toml", tmp_path / "site/drive.toml"
    lines = fit(kind, general, [Walk(12, 0.2, 0.1), Walk(10, 0.1, 0.2)], general=True, **given)
    assert any("update 1" in line for line in lines)
    settings = read_card(general).settings
    assert (settings["resolution_input"], settings["step_s"], settings["blank_frames"]) == (True, 0.1, 10)
    assert not {"samples", "device"} & settings.keys()
    for period_s in (0.1, 0.2, 0.05):
        source = Walk(13, 0.2, period_s, frames=5, drift=1)
        constant(trained(kind, general, source), source, 3)
    fit(kind, site, [Drive()], start=general, objective=log_loss_of)
    assert given.items() <= read_card(site).settings.items()
    assert forecast_of(trained(kind, site, Drive()), Drive(20, start=30), 12)[1:].min() > 0.0


def test_the_number_of_samples_does_not_depend_on_the_training_but_the_shape_does(tmp_path):
    card = tmp_path / "drive.toml"
    fit(SOGMPTracker, card, [Drive(40)], blank_frames=1, repetitions=1, **TINY[SOGMPTracker])
    made = trained(SOGMPTracker, card, Drive(), samples=5)
    made.update(next(iter(Drive())))
    assert made.predict(1).futures.shape == (5, 2, 12, 12)
    with pytest.raises(WeightsError, match="trained with channels=2, not 3"):
        trained(SOGMPTracker, card, Drive(), channels=3)
