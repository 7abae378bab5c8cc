"""The recurrent networks equal the equations of their papers."""

from __future__ import annotations

import pytest

torch = pytest.importorskip("torch")
from torch.nn.functional import conv2d  # noqa: E402

from gridtrack.trackers.recurrent.deep_tracking_rnn import DeepTrackingRNN  # noqa: E402
from gridtrack.trackers.recurrent.dilated_convgru import DilatedConvGRU, convgru_gates  # noqa: E402
from gridtrack.trackers.recurrent.fit import start_from_rate
from gridtrack.trackers.recurrent.kernels.gates import StaticMemory, differentiable_gates
from gridtrack.trackers.recurrent.network import channels_last
from gridtrack.trackers.recurrent.settings import (  # noqa: E402
    GATES,
    DeepTrackingRNNSettings,
    DilatedConvGRUSettings,
    TrainingSettings,
)


def parameters(network) -> int:
    return sum(p.numel() for p in network.parameters())


def randomised(network):
    generator = torch.Generator().manual_seed(3)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.copy_(0.3 * torch.randn(parameter.shape, generator=generator))
    return network


def test_convgru_has_the_number_of_parameters_of_its_equations():
    assert parameters(DilatedConvGRU(100, DilatedConvGRUSettings(), classes=4)) == 1_476_149


@pytest.mark.parametrize(("variant", "expected"), [("code", 78_449), ("paper", 11_193)])
def test_deep_tracking_rnn_has_the_published_number_of_parameters(variant, expected):
    assert parameters(DeepTrackingRNN(100, DeepTrackingRNNSettings(variant=variant))) == expected


def test_only_static_gates_have_a_static_memory():
    some = DilatedConvGRU(10, DilatedConvGRUSettings(static_gates=("candidate",)))
    assert parameters(some) == parameters(DilatedConvGRU(10, DilatedConvGRUSettings())) - 3 * 2 * 16 * (100 - 1)


def test_a_convgru_layer_equals_its_equations_with_six_separate_convolutions():
    network = randomised(DilatedConvGRU(11, DilatedConvGRUSettings(layers=2, channels=3)))
    layer = network.layers[1]
    x, h = torch.randn(2, 3, 11, 11), torch.randn(2, 3, 11, 11)
    wxz, wxr, wxh = layer.input_weight.split(3)
    whz, whr, whh = layer.state_weight.split(3)
    bz, br, bh = (layer.biases[gate] for gate in ("keep", "reset", "candidate"))

    def dilated(image, weight):
        return conv2d(image, weight, padding=2, dilation=2)

    f = torch.sigmoid(dilated(x, wxz) + dilated(h, whz) + bz)
    r = torch.sigmoid(dilated(x, wxr) + dilated(h, whr) + br)
    c = torch.tanh(dilated(x, wxh) + r * dilated(h, whh) + bh)
    torch.testing.assert_close(layer(x, h), f * h + (1 - f) * c)


def test_a_cell_without_gates_is_the_candidate():
    layer = randomised(DilatedConvGRU(7, DilatedConvGRUSettings(layers=2, channels=3, cell="plain"))).layers[1]
    x, h = torch.randn(2, 3, 7, 7), torch.randn(2, 3, 7, 7)
    x_conv, h_conv = (
        conv2d(image, weight, padding=2, dilation=2)
        for image, weight in ((x, layer.input_weight), (h, layer.state_weight))
    )
    torch.testing.assert_close(layer(x, h), torch.tanh(x_conv + h_conv + layer.biases["candidate"]))


def test_without_dilation_the_receptive_field_is_seven_cells_square():
    assert receptive_field(DilatedConvGRUSettings(dilated=False)) == (12, 18, 12, 18)


@pytest.mark.parametrize("precision", [torch.float32, torch.bfloat16])
@pytest.mark.parametrize("static_gates", [("keep", "reset", "candidate"), ("reset",)])
@pytest.mark.parametrize("with_input", [True, False])
def test_the_differentiable_gates_equal_the_gates_and_their_gradient(with_input, static_gates, precision):
    settings = DilatedConvGRUSettings(channels=5, static_gates=static_gates)
    layer = channels_last(randomised(DilatedConvGRU(9, settings))).layers[0]
    biases = tuple(layer.biases[gate] for gate in GATES)
    x, h_conv, h, above = (torch.randn(2, c, 9, 9, requires_grad=True) for c in (15, 15, 5, 5))
    x_conv = x.to(precision) if with_input else None
    leaves = (*biases, h, h_conv, x)[: None if with_input else -1]

    expected = convgru_gates(x_conv, h_conv.to(precision), biases, h)
    found, rounded = differentiable_gates(x_conv, h_conv.to(precision), StaticMemory(biases, 9), h)

    torch.testing.assert_close(found, expected, rtol=0, atol=2e-6)
    assert rounded is None if precision == torch.float32 else torch.equal(rounded, found.bfloat16())
    tolerance = {"rtol": 1e-5, "atol": 1e-5} if precision == torch.float32 else {"rtol": 2**-7, "atol": 1e-4}
    for found_gradient, expected_gradient in zip(
        torch.autograd.grad(found, leaves, above), torch.autograd.grad(expected, leaves, above), strict=True
    ):
        torch.testing.assert_close(found_gradient, expected_gradient, **tolerance)


def receptive_field(settings):
    network = randomised(DilatedConvGRU(31, settings))
    x = torch.zeros(1, 2, 31, 31, requires_grad=True)
    network.features(network.step(x, network.initial(1)))[0, :, 15, 15].sum().backward()
    rows, columns = torch.nonzero(x.grad[0, 0], as_tuple=True)
    return rows.min(), rows.max(), columns.min(), columns.max()


def test_the_receptive_field_of_one_step_is_fifteen_cells_square():
    assert receptive_field(DilatedConvGRUSettings()) == (8, 22, 8, 22)


@pytest.mark.parametrize(
    "network",
    [
        DilatedConvGRU(12, DilatedConvGRUSettings(channels=4)),
        DilatedConvGRU(12, DilatedConvGRUSettings(channels=4, cell="plain")),
        DeepTrackingRNN(12, DeepTrackingRNNSettings(variant="paper")),
    ],
    ids=["convgru", "plain", "rnn"],
)
def test_the_empty_input_equals_two_zero_planes(network):
    randomised(network)
    state = network.step((torch.rand(1, 2, 12, 12) < 0.3).float(), network.initial(1))
    for skipped, computed in zip(
        network.step(None, state), network.step(torch.zeros(1, 2, 12, 12), state), strict=True
    ):
        torch.testing.assert_close(skipped, computed)


def test_the_deep_tracking_rnn_equals_its_equations():
    network = randomised(DeepTrackingRNN(9, DeepTrackingRNNSettings(variant="paper")))
    x, h = torch.rand(1, 2, 9, 9), torch.rand(1, 16, 9, 9)
    e = torch.sigmoid(conv2d(x, network.encode.weight, network.encode.bias, padding=3))
    expected = torch.sigmoid(conv2d(torch.cat([e, h], 1), network.recur.weight, network.recur.bias, padding=2))
    torch.testing.assert_close(network.step(x, (h,))[0], expected)


def test_an_untrained_network_forecasts_the_occupied_rate():
    network = DilatedConvGRU(10, DilatedConvGRUSettings(channels=4))
    start_from_rate(network.decode_occupancy, 0.02)
    occupancy = torch.sigmoid(network.occupancy(network.features(network.initial(1))))
    torch.testing.assert_close(occupancy, torch.full((1, 10, 10), 0.02))


@pytest.mark.parametrize("variant", ["code", "paper"])
def test_an_untrained_deep_tracking_rnn_holds_what_it_saw_last(variant):
    torch.manual_seed(0)
    network = DeepTrackingRNN(21, DeepTrackingRNNSettings(variant=variant))
    start_from_rate(network.decode, 0.02)
    hidden_since, left_since = (6, 6), (14, 14)
    x = torch.zeros(1, 2, 21, 21)
    x[:, 0] = 1.0
    for cell in (hidden_since, left_since):
        x[0, 1, *cell] = 1.0
    state = network.step(x, network.initial(1))
    x[0, 1, *left_since] = 0.0
    x[0, :, *hidden_since] = 0.0
    for _ in range(5):
        state = network.step(x, state)
    for _ in range(10):
        state = network.step(None, state)
    occupancy = torch.sigmoid(network.occupancy(network.features(state)))[0]
    assert occupancy[hidden_since] > 0.5
    occupancy[hidden_since] = 0.0
    assert occupancy.max() < 0.5


def test_the_default_sequence_is_ten_observed_and_ten_blank_frames_twice():
    settings = TrainingSettings()
    observed = [settings.is_observed(frame) for frame in range(settings.length)]
    assert observed == [*[True] * 10, *[False] * 10] * 2
