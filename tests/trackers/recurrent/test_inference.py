"""The inference networks equal the trained networks, and do not convolve an empty input."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch")
from torch.nn.functional import conv2d  # noqa: E402

from gridtrack.common.errors import ConfigurationError  # noqa: E402
from gridtrack.trackers.recurrent.convgru_tracker import DilatedConvGRUTracker  # noqa: E402
from gridtrack.trackers.recurrent.deep_tracking_rnn import DeepTrackingRNN  # noqa: E402
from gridtrack.trackers.recurrent.dilated_convgru import DilatedConvGRU, convgru_gates  # noqa: E402
from gridtrack.trackers.recurrent.inference import InferencePlainConvGRU
from gridtrack.trackers.recurrent.kernels.convgru import InferenceConvGRU, bias_rows
from gridtrack.trackers.recurrent.kernels.convolutions import WinogradConvolution
from gridtrack.trackers.recurrent.kernels.gates import fused_gates
from gridtrack.trackers.recurrent.kernels.rnn import InferenceRNN
from gridtrack.trackers.recurrent.network import as_cells, channels_last  # noqa: E402
from gridtrack.trackers.recurrent.settings import (  # noqa: E402
    GATES,
    DeepTrackingRNNSettings,
    DilatedConvGRUSettings,
)

CHANNELS = 4


def random(*shape, scale=1.0):
    return scale * torch.randn(shape, generator=torch.Generator().manual_seed(sum(shape)))


def randomised(network):
    generator = torch.Generator().manual_seed(3)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.copy_(0.3 * torch.randn(parameter.shape, generator=generator))
    return channels_last(network).requires_grad_(requires_grad=False)


def convgru(size=21, **settings):
    return randomised(DilatedConvGRU(size, DilatedConvGRUSettings(channels=CHANNELS, **settings)))


def rnn():
    return randomised(DeepTrackingRNN(12, DeepTrackingRNNSettings(variant="paper")))


def frames(size, count=3):
    """`count` random frames, then `count` empty inputs."""
    seen = [(random(1, 2, size, size + t)[..., :size] > 0.3).float() for t in range(count)]
    return [x.contiguous(memory_format=torch.channels_last) for x in seen] + [None] * count


@pytest.mark.parametrize("dilation", [1, 2, 4])
@pytest.mark.parametrize("size", [2, 3, 9, 33])
def test_winograd_sums_the_convolutions_of_all_images(size, dilation):
    images, weight = [random(size, size, CHANNELS), random(size, size, 2)], random(8, CHANNELS + 2, 3, 3, scale=0.1)
    convolution = WinogradConvolution(weight, (CHANNELS, 2), size, dilation)
    found = torch.full((size, size, 8), torch.nan)
    for rows, sums in convolution.bands([image.numpy() for image in images]):
        assert found[rows].isnan().all(), "a row comes once"
        found[rows] = torch.from_numpy(sums[:, :size].copy())
    stacked = torch.cat(images, dim=2).permute(2, 0, 1)[None]
    expected = conv2d(stacked, weight, padding=dilation, dilation=dilation)[0].permute(1, 2, 0)
    torch.testing.assert_close(found, expected, rtol=0, atol=2e-5)


@pytest.mark.parametrize("static_gates", [("keep", "reset", "candidate"), ("candidate",), ()])
@pytest.mark.parametrize("with_input", [True, False])
@pytest.mark.parametrize("bfloat16", [True, False])
def test_the_fused_gates_equal_the_gates(bfloat16, with_input, static_gates):
    network = convgru(9, static_gates=static_gates)
    biases = tuple(network.layers[0].biases[gate] for gate in GATES)
    x = random(1, 3 * CHANNELS, 9, 9, scale=10.0) if with_input else None
    h_conv, h = random(1, 3 * CHANNELS, 9, 9, scale=10.0), random(1, CHANNELS, 9, 9, scale=0.5)
    h_conv[0, :, 0, 0], h_conv[0, :, 0, 1] = 300.0, -300.0  # saturated, and not overflown

    if bfloat16:
        h_conv, x = h_conv.bfloat16().float(), None if x is None else torch.zeros_like(x)
    sums = h_conv
    if x is not None:
        of_both, of_x = x.split([2 * CHANNELS, CHANNELS], dim=1)
        sums = torch.cat([h_conv[:, : 2 * CHANNELS] + of_both, h_conv[:, 2 * CHANNELS :], of_x], dim=1)
    if bfloat16:
        sums = sums.bfloat16().view(torch.uint16)
    maps = bias_rows(biases)
    map_cells = np.arange(81, dtype=np.int32).reshape(9, 9) if static_gates else np.zeros((9, 9), np.int32)
    h_cells, sums_cells = (as_cells(t.contiguous(memory_format=torch.channels_last)) for t in (h, sums))
    found = torch.full((9, 9, CHANNELS), torch.nan)
    for top in (0, 1):
        rows = sums_cells[top::2].copy()
        gates = fused_gates(CHANNELS, with_input=with_input, bfloat16=bfloat16)
        gates(rows, top, 2, map_cells, *maps, h_cells, found.numpy())

    expected = convgru_gates(x, h_conv, biases, h)[0].permute(1, 2, 0)
    torch.testing.assert_close(found, expected, rtol=0, atol=2e-6)


@pytest.mark.parametrize(
    "settings", [{}, {"static_gates": ("candidate",)}, {"static_gates": ()}, {"dilated": False, "layers": 2}]
)
def test_the_inference_convgru_equals_the_trained_network(settings):
    assert_same_stream(network := convgru(**settings), InferenceConvGRU(network), network.size)


def test_the_inference_rnn_equals_the_trained_network():
    assert_same_stream(network := rnn(), InferenceRNN(network), network.size)


def test_the_bfloat16_network_equals_the_trained_one_to_three_digits():
    network = convgru()
    assert_same_stream(network, InferenceConvGRU(network, bfloat16=True), network.size, within=0.05)


def assert_same_stream(trained, following, size, within=1e-4):
    state, followed = trained.initial(1), following.initial(1)
    for x in frames(size):
        state, followed = trained.step(x, state), following.step(x, followed)
        for expected, found in zip(state, followed, strict=True):
            torch.testing.assert_close(found, expected, rtol=0, atol=within)
        expected, found = (n.occupancy(n.features(s)) for n, s in ((trained, state), (following, followed)))
        torch.testing.assert_close(found, expected, rtol=0, atol=within)


def test_a_step_does_not_change_its_input_state():
    following = InferenceConvGRU(convgru())
    x, *_ = frames(following.size)
    state = following.step(x, following.initial(1))
    kept = [h.clone() for h in state]
    following.step(x, following.step(None, state))
    assert all(torch.equal(h, before) for h, before in zip(state, kept, strict=True))


def test_an_empty_input_is_not_convolved():
    network = convgru()
    network.layers[0].input_weight.fill_(torch.nan)
    following = InferenceConvGRU(network)
    assert all(h.isfinite().all() for h in following.step(None, following.initial(1)))


def test_a_network_without_gates_computes_as_it_was_trained():
    network, options = convgru(cell="plain"), DilatedConvGRUTracker.Options
    following = DilatedConvGRUTracker.prepare_inference(network, options())
    assert isinstance(following, InferencePlainConvGRU)
    assert_same_stream(network, following, network.size, within=0)
    with pytest.raises(ConfigurationError, match="cell=gru"):
        DilatedConvGRUTracker.prepare_inference(network, options(inference="bfloat16"))
