"""Every variant of a network in `kernels` equals it; for training, its gradient does too."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch.nn.functional import binary_cross_entropy_with_logits, conv2d

from gridtrack.common.errors import ConfigurationError
from gridtrack.trackers.recurrent.convgru_tracker import DilatedConvGRUTracker
from gridtrack.trackers.recurrent.dilated_convgru import convgru_gates
from gridtrack.trackers.recurrent.inference import InferenceNetwork
from gridtrack.trackers.recurrent.kernels import convgru as convgru_kernels
from gridtrack.trackers.recurrent.kernels import rnn as rnn_kernels
from gridtrack.trackers.recurrent.kernels.convolutions import WinogradConvolution
from gridtrack.trackers.recurrent.kernels.gates import fused_gates
from gridtrack.trackers.recurrent.network import as_cells, resolution_of, set_resolution
from gridtrack.trackers.recurrent.settings import GATES
from tests.trackers.recurrent.sources import convgru, rnn

CHANNELS = 4
GENERAL = {"resolution_input": True}
NETWORKS = {
    "convgru": (convgru_kernels, convgru, {}),
    "some maps": (convgru_kernels, convgru, {"static_gates": ("candidate",)}),
    "general": (convgru_kernels, convgru, {"static_gates": (), **GENERAL}),
    "dense": (convgru_kernels, convgru, {"dilated": False, "layers": 2}),
    "rnn": (rnn_kernels, rnn, {}),
    "general rnn": (rnn_kernels, rnn, GENERAL),
}


def built(build, settings):
    """A network for grids of 21 cells a side; if it is general, it is made for others, and has a resolution."""
    if "resolution_input" not in settings:
        return build(21, **settings)
    network = build(12, **settings)
    network.size = 21
    set_resolution(network, resolution_of(0.05, 0.2))
    return network


def variants(table):
    """The networks, and each variant of theirs in INFERENCE or TRAINING."""
    return [
        pytest.param(lambda build=build, settings=settings: built(build, settings), key, variant, id=f"{name}-{key}")
        for name, (kernels, build, settings) in NETWORKS.items()
        for key, variant in getattr(kernels, table).items()
    ]


def random(*shape, scale=1.0):
    return scale * torch.randn(shape, generator=torch.Generator().manual_seed(sum(shape)))


def frames(size, batch=1, count=3):
    """`count` random frames, then `count` empty inputs."""
    seen = [(random(batch, 2, size, size + t)[..., :size] > 0.3).float() for t in range(count)]
    return [x.contiguous(memory_format=torch.channels_last) for x in seen] + [None] * count


def run(network, inputs, batch=1):
    """The features and the logits (B, M, M) after each input."""
    state = network.initial(batch)
    for x in inputs:
        state = network.step(x, state)
        features = network.features(state)
        yield features.float(), network.occupancy(features).float()


@pytest.mark.parametrize(("build", "precision", "variant"), variants("INFERENCE"))
def test_a_variant_for_inference_equals_its_network(build, precision, variant):
    network = build()
    inputs, tolerance = frames(21), 0.05 if precision == "bfloat16" else 1e-4
    with torch.inference_mode():
        for found, expected in zip(run(variant(network), inputs), run(network, inputs), strict=True):
            for one, other in zip(found, expected, strict=True):
                torch.testing.assert_close(one, other, rtol=0, atol=tolerance)


@pytest.mark.parametrize(("half", "tolerance"), [(False, 1e-5), (True, 0.01)])
@pytest.mark.parametrize(("build", "device", "variant"), variants("TRAINING"))
def test_a_variant_for_training_has_the_loss_and_gradient_of_its_network(
    monkeypatch, build, device, variant, half, tolerance
):
    """The variant for a CUDA device is computed here on the processor, its gates by PyTorch's operations."""
    monkeypatch.setattr(convgru_kernels, "compiled_gates", lambda: convgru_kernels.plain_gates)
    network = build().requires_grad_()

    def loss_and_gradient(one):
        with torch.autocast("cpu", torch.bfloat16, enabled=half):
            logits = torch.stack([logits for _, logits in run(one, frames(21, batch=2), batch=2)])
        loss = binary_cross_entropy_with_logits(logits, (random(*logits.shape) > 1.0).float())
        return loss.detach(), torch.autograd.grad(loss, tuple(network.parameters()))

    loss, gradient = loss_and_gradient(network)
    found_loss, found_gradient = loss_and_gradient(variant(network))

    torch.testing.assert_close(found_loss, loss, rtol=tolerance, atol=0)
    for found, expected in zip(found_gradient, gradient, strict=True):
        assert (found - expected).norm() < tolerance * expected.norm()


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


@pytest.mark.parametrize("with_input", [True, False])
@pytest.mark.parametrize("bfloat16", [True, False])
def test_the_fused_gates_equal_the_gates_also_where_they_are_saturated(bfloat16, with_input):
    biases = tuple(convgru(9).layers[0].biases[gate] for gate in GATES)
    x = random(1, 3 * CHANNELS, 9, 9, scale=10.0) if with_input else None
    h_conv, h = random(1, 3 * CHANNELS, 9, 9, scale=10.0), random(1, CHANNELS, 9, 9, scale=0.5)
    h_conv[0, :, 0, 0], h_conv[0, :, 0, 1] = 300.0, -300.0

    if bfloat16:
        h_conv, x = h_conv.bfloat16().float(), None if x is None else torch.zeros_like(x)
    sums = h_conv
    if x is not None:
        of_both, of_x = x.split([2 * CHANNELS, CHANNELS], dim=1)
        sums = torch.cat([h_conv[:, : 2 * CHANNELS] + of_both, h_conv[:, 2 * CHANNELS :], of_x], dim=1)
    if bfloat16:
        sums = sums.bfloat16().view(torch.uint16)
    h_cells, sums_cells = (as_cells(t.contiguous(memory_format=torch.channels_last)) for t in (h, sums))
    found = torch.full((9, 9, CHANNELS), torch.nan)
    gates = fused_gates(CHANNELS, with_input=with_input, bfloat16=bfloat16)
    map_cells = np.arange(81, dtype=np.int32).reshape(9, 9)
    for top in (0, 1):
        rows = sums_cells[top::2].copy()
        gates(rows, top, 2, map_cells, *convgru_kernels.bias_rows(biases), h_cells, found.numpy())

    expected = convgru_gates(x, h_conv, biases, h)[0].permute(1, 2, 0)
    torch.testing.assert_close(found, expected, rtol=0, atol=2e-6)


def test_an_empty_input_is_not_convolved():
    network = convgru()
    network.layers[0].input_weight.fill_(torch.nan)
    variant = convgru_kernels.InferenceConvGRU(network)
    assert all(h.isfinite().all() for h in variant.step(None, variant.initial(1)))


def test_a_network_without_gates_computes_as_it_was_trained():
    network, options = convgru(cell="plain"), DilatedConvGRUTracker.Options
    assert type(DilatedConvGRUTracker.prepare_inference(network, options())) is InferenceNetwork
    assert DilatedConvGRUTracker.prepare_training(network, "cpu") is network
    with pytest.raises(ConfigurationError, match="cell=gru"):
        DilatedConvGRUTracker.prepare_inference(network, options(inference="bfloat16"))
