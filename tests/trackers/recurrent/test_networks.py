"""The recurrent networks equal the equations of their papers."""

from __future__ import annotations

import pytest
import torch
from torch.nn.functional import conv2d

from gridtrack.trackers.recurrent.conv_lstm import ConvLSTM, ConvLSTMLayer, ConvLSTMSettings, LSTMState
from gridtrack.trackers.recurrent.deep_tracking_rnn import DeepTrackingRNN
from gridtrack.trackers.recurrent.dilated_convgru import DilatedConvGRU
from gridtrack.trackers.recurrent.fit import start_from_rate
from gridtrack.trackers.recurrent.settings import DeepTrackingRNNSettings, DilatedConvGRUSettings
from tests.trackers.recurrent.sources import conv_lstm, convgru, randomised, rnn


def parameters(network) -> int:
    return sum(p.numel() for p in network.parameters())


@pytest.mark.parametrize(
    ("network", "expected"),
    [
        (DilatedConvGRU(100, DilatedConvGRUSettings(), classes=4), 1_476_149),
        (DeepTrackingRNN(100, DeepTrackingRNNSettings(variant="code")), 78_449),
        (DeepTrackingRNN(100, DeepTrackingRNNSettings(variant="paper")), 11_193),
        (ConvLSTM(100, ConvLSTMSettings()), 47_569),
        (ConvLSTM(100, ConvLSTMSettings(resolution_input=True)), 47_569 + 3 * 4 * 16 * 2),
    ],
)
def test_a_network_has_the_published_number_of_parameters_or_that_of_its_equations(network, expected):
    assert parameters(network) == expected


def test_a_conv_lstm_layer_equals_its_equations_with_eight_separate_convolutions():
    layer = randomised(ConvLSTMLayer(2, 3, resolution_input=False))
    x, h, c = torch.randn(2, 2, 9, 9), torch.randn(2, 3, 9, 9), torch.randn(2, 3, 9, 9)
    from_x, from_h = layer.weight[:, :2].split(3), layer.weight[:, 2:].split(3)
    sums = [
        conv2d(x, wx, padding=1) + conv2d(h, wh, padding=1) + b[:, None, None]
        for wx, wh, b in zip(from_x, from_h, layer.bias.split(3), strict=True)
    ]
    take, keep, show = map(torch.sigmoid, sums[:3])
    new = keep * c + take * torch.tanh(sums[3])
    found = layer(x, LSTMState(h, c))
    torch.testing.assert_close(found, LSTMState(show * torch.tanh(new), new))


def test_only_static_gates_have_a_static_memory():
    some = DilatedConvGRU(10, DilatedConvGRUSettings(static_gates=("candidate",)))
    assert parameters(some) == parameters(DilatedConvGRU(10, DilatedConvGRUSettings())) - 3 * 2 * 16 * (100 - 1)


def test_a_convgru_layer_equals_its_equations_with_six_separate_convolutions():
    layer = convgru(11, channels=3, layers=2).layers[1]
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
    layer = convgru(7, channels=3, layers=2, cell="plain").layers[1]
    x, h = torch.randn(2, 3, 7, 7), torch.randn(2, 3, 7, 7)
    x_conv, h_conv = (
        conv2d(image, weight, padding=2, dilation=2)
        for image, weight in ((x, layer.input_weight), (h, layer.state_weight))
    )
    torch.testing.assert_close(layer(x, h), torch.tanh(x_conv + h_conv + layer.biases["candidate"]))


@pytest.mark.parametrize(("dilated", "first", "last"), [(True, 8, 22), (False, 12, 18)])
def test_the_receptive_field_of_one_step_is_fifteen_cells_square_and_seven_without_dilation(dilated, first, last):
    network = convgru(31, dilated=dilated)
    x = torch.zeros(1, 2, 31, 31, requires_grad=True)
    network.features(network.step(x, network.initial(1)))[0, :, 15, 15].sum().backward()
    rows, columns = torch.nonzero(x.grad[0, 0], as_tuple=True)
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (first, last, first, last)


@pytest.mark.parametrize(
    "network", [convgru(), convgru(cell="plain"), rnn(), conv_lstm()], ids=["convgru", "plain", "rnn", "lstm"]
)
def test_the_empty_input_equals_two_zero_planes(network):
    state = network.step((torch.rand(1, 2, 12, 12) < 0.3).float(), network.initial(1))
    torch.testing.assert_close(network.step(None, state), network.step(torch.zeros(1, 2, 12, 12), state))


def test_the_deep_tracking_rnn_equals_its_equations():
    network = rnn(9)
    x, h = torch.rand(1, 2, 9, 9), torch.rand(1, 16, 9, 9)
    e = torch.sigmoid(conv2d(x, network.encode.weight, network.encode.bias, padding=3))
    expected = torch.sigmoid(conv2d(torch.cat([e, h], 1), network.recur.weight, network.recur.bias, padding=2))
    torch.testing.assert_close(network.step(x, (h,))[0], expected)


def test_an_untrained_network_forecasts_the_occupied_rate():
    network = DilatedConvGRU(10, DilatedConvGRUSettings(channels=4))
    start_from_rate(network, 0.02)
    occupancy = torch.sigmoid(network.occupancy(network.features(network.initial(1))))
    torch.testing.assert_close(occupancy, torch.full((1, 10, 10), 0.02))


@pytest.mark.parametrize("variant", ["code", "paper"])
def test_an_untrained_deep_tracking_rnn_remembers_cells_as_last_seen(variant):
    torch.manual_seed(0)
    network = DeepTrackingRNN(21, DeepTrackingRNNSettings(variant=variant))
    start_from_rate(network, 0.02)
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
