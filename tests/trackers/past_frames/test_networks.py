"""The networks of the last frames: their sizes, what they read and feed back, and the loss of their training."""

from __future__ import annotations

import pytest
import torch
from torch.nn.functional import binary_cross_entropy_with_logits

from gridtrack.common.config import validated
from gridtrack.trackers.past_frames.network import PAST_STEPS, PastFramesTraining
from gridtrack.trackers.past_frames.simvp import SimVP, SimVPSettings, SimVPTracker
from gridtrack.trackers.past_frames.sogmp import SOGMP, SOGMPSettings, SOGMPTracker
from gridtrack.trackers.recurrent.conv_lstm import ConvLSTMTracker
from gridtrack.trackers.recurrent.fit import start_from_rate
from gridtrack.trackers.recurrent.network import set_resolution
from gridtrack.trackers.recurrent.sequences import SequenceDataset
from gridtrack.trackers.recurrent.training_module import sequence_loss
from tests.trackers.recurrent.sources import Shuttle, randomised


def simvp(size=12, **settings):
    return randomised(SimVP(size, SimVPSettings(channels=2, hidden=4, blocks=2, **settings)), 0.5)


def sogmp(size=12, **settings):
    return randomised(SOGMP(size, SOGMPSettings(channels=2, hidden=4, **settings)), 0.5)


BOTH = pytest.mark.parametrize("made", [simvp, sogmp])


def past(size=12, batch=2):
    draw = torch.Generator().manual_seed(5)
    visible, hit = (torch.rand(2, batch, PAST_STEPS, size, size, generator=draw) < 0.4).float()
    return torch.stack([visible, visible * hit], dim=2)


def seeded():
    return torch.Generator().manual_seed(9)


@pytest.mark.parametrize(
    ("network", "expected"), [(SimVP(64, SimVPSettings()), 1_664_529), (SOGMP(64, SOGMPSettings()), 730_885)]
)
def test_a_network_has_its_published_size(network, expected):
    assert sum(p.numel() for p in network.parameters()) == expected


@BOTH
@pytest.mark.parametrize("size", [1, 5, 12])
def test_a_grid_of_any_size_is_padded_to_whole_strides_and_cut(made, size):
    x = past(size)
    logits = made().forecast(x, 1, seeded()).logits
    assert logits.shape == (2, 1, size, size)
    room = -size % 4
    wider = made().forecast(torch.nn.functional.pad(x, (0, room, 0, room)), 1, seeded()).logits
    torch.testing.assert_close(logits, wider[..., :size, :size])


@BOTH
def test_further_steps_are_those_of_the_network_on_its_own_forecast(made):
    """With one source of random numbers the first steps are the same whatever the horizon."""
    network, x, draw = made(), past(), seeded()
    first = network.next_steps(x, draw).logits
    count = first.shape[1]
    assert count == (PAST_STEPS if made is simvp else 1)
    p = torch.sigmoid(first)
    fed = torch.cat([x, torch.stack([torch.ones_like(p), p], dim=2)], dim=1)[:, -PAST_STEPS:]
    second = network.next_steps(fed, draw).logits
    found = network.forecast(x, count + 1, seeded()).logits
    torch.testing.assert_close(found, torch.cat([first, second[:, :1]], dim=1))


def test_sogmp_reads_occupied_cells_alone_and_its_samples_differ():
    network, x = sogmp(), past()
    hidden = x.clone()
    hidden[:, :, 0] = 0
    torch.testing.assert_close(network.forecast(x, 1, seeded()).logits, network.forecast(hidden, 1, seeded()).logits)
    one, other = network.forecast(x[:1].expand(2, -1, -1, -1, -1), 1).logits
    assert (one - other).abs().max() > 1e-3


def test_the_penalty_of_sogmp_is_a_hundredth_of_the_divergence_of_its_latent_maps():
    network, x = sogmp(), past()
    mean, log_variance = network.encode(network._followed(x[:, :, 1:])).chunk(2, dim=1)
    posterior = torch.distributions.Normal(mean, torch.exp(0.5 * log_variance))
    divergence = torch.distributions.kl_divergence(posterior, torch.distributions.Normal(0.0, 1.0)).sum()
    torch.testing.assert_close(network.forecast(x, 1).penalty, 0.01 * divergence)


@BOTH
def test_each_window_of_a_batch_has_its_own_resolution(made):
    network, x = made(resolution_input=True), past()
    resolutions = torch.tensor([[-1.0, 0.5], [1.0, -0.5]])
    set_resolution(network, resolutions)
    together = network.forecast(x, 1, torch.Generator().manual_seed(1)).logits
    set_resolution(network, resolutions[0])
    alone = network.forecast(x, 1, torch.Generator().manual_seed(1)).logits
    torch.testing.assert_close(together[0], alone[0])
    assert (together[1] - alone[1]).abs().max() > 1e-3


def test_the_loss_is_that_of_each_blank_frame_forecast_from_the_ten_observed_before_it():
    """By hand: two series of three blank frames; before the first one are four observed frames, and nothing."""
    settings = PastFramesTraining(observed_frames=4, blank_frames=3, repetitions=2, unseen_weight=0.5)
    network, windows = simvp(), torch.cat([past(), past()[:, :4].flip(1)], dim=1)
    windows[:, :, :, 0] = 0
    found = sequence_loss(network, windows, settings, 0.05)

    nothing = torch.zeros_like(windows[:, :1])
    shown = [*[nothing] * 6, *windows[:, :4].split(1, 1), *[nothing] * 3, *windows[:, 7:11].split(1, 1)]
    total, weights = 0.0, 0.0
    for end, blank in ((10, range(4, 7)), (17, range(11, 14))):
        logits = network.forecast(torch.cat(shown[end - 10 : end], dim=1), 3).logits
        visible, occupied = windows[:, blank].unbind(dim=2)
        cells = binary_cross_entropy_with_logits(logits, occupied, reduction="none")
        total += (visible * cells).sum()
        never = logits[~windows[:, :, 0].bool().any(dim=1, keepdim=True).expand_as(logits)]
        total += 0.5 * binary_cross_entropy_with_logits(never, torch.full_like(never, 0.05), reduction="sum")
        weights += visible.sum()
    torch.testing.assert_close(found.total, total)
    torch.testing.assert_close(found.visible_weight, weights)


def test_the_loss_contains_the_penalty():
    settings = PastFramesTraining(observed_frames=10, blank_frames=1, repetitions=1)
    network, windows = sogmp(), torch.cat([past(), past()[:, :1]], dim=1)
    torch.manual_seed(4)
    ahead = network.forecast(windows[:, :10], 1)
    visible, occupied = windows[:, 10].unbind(dim=1)
    cells = binary_cross_entropy_with_logits(ahead.logits[:, 0], occupied, weight=visible, reduction="sum")
    torch.manual_seed(4)
    torch.testing.assert_close(sequence_loss(network, windows, settings, 0.05).total, cells + ahead.penalty)


SMALL = {
    ConvLSTMTracker: ({"channels": 8, "blank_frames": 2}, 0.01, 60),
    SimVPTracker: ({"channels": 4, "hidden": 16, "blocks": 2, "blank_frames": 3}, 0.02, 80),
    SOGMPTracker: ({"channels": 16, "hidden": 32, "blank_frames": 1}, 0.005, 140),
}
"""Options of a small network, its learning rate and the number of updates."""


@pytest.mark.parametrize("kind", SMALL)
def test_a_small_network_learns_where_a_dot_goes_which_no_floor_does(kind):
    given, rate, updates = SMALL[kind]
    options = validated(kind.Options, {"observed_frames": 10, "repetitions": 1} | given, "test")
    data = SequenceDataset([Shuttle()], options, seed=0)
    windows = torch.stack([data[number].window for number in range(4)]).float()
    torch.manual_seed(0)
    network = kind.build(data.size, options, 0)
    start_from_rate(network, data.occupied_rate)
    optimizer = torch.optim.Adam(network.parameters(), lr=rate)
    for _ in range(updates):
        optimizer.zero_grad()
        sequence_loss(network, windows, options, data.occupied_rate).mean.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
    with torch.no_grad():
        logits = network.forecast_windows(windows, options).logits
    blank = windows[:, 10:, 1].transpose(0, 1).flatten(0, 1)
    found = logits[-len(blank) :, 5].argmax(dim=-1)
    assert found.tolist() == blank[:, 5].argmax(dim=-1).tolist()
