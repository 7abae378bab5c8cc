"""Inference on a device of torch: the same forecasts as by the kernels, and a clear refusal without the device.

No test machine has an accelerator: PyTorch's own operations run on the processor, and the placement of all tensors is
checked on the device `meta`, which has shapes and no numbers.
"""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

import pytest
import torch

from gridtrack.common.errors import ConfigurationError
from gridtrack.trackers import one_shot
from gridtrack.trackers.one_shot import OneShotTracker
from gridtrack.trackers.recurrent import network_tracker
from gridtrack.trackers.recurrent.convgru_tracker import DilatedConvGRUTracker
from gridtrack.trackers.recurrent.inference import InferenceNetwork
from gridtrack.trackers.recurrent.network import tensors_of
from gridtrack.trackers.registry import registered_name
from gridtrack.trackers.training.device import inference_device
from tests.trackers.recurrent.sources import TRACKERS, Walk, convgru, forecast_of, rnn, trained

WALK = Walk(20, 0.2, 0.2, frames=12, drift=1)
"""Two steps a frame, in a window that moves."""


def general_card(tracker):
    return Path(str(files("gridtrack.data"))) / "weights" / registered_name(tracker) / "general.toml"


def by_pytorch(monkeypatch, tracker):
    """The tracker computes as on a device without kernels."""
    monkeypatch.setattr(
        tracker, "prepare_inference", classmethod(lambda cls, network, options: InferenceNetwork(network))
    )


@pytest.mark.parametrize("tracker", TRACKERS)
def test_pytorch_and_the_kernels_forecast_the_same(monkeypatch, tracker):
    kernels = forecast_of(trained(tracker, general_card(tracker), WALK), WALK, 5)
    by_pytorch(monkeypatch, tracker)
    torch_only = trained(tracker, general_card(tracker), WALK, device="cpu")
    assert type(torch_only.network.network) is InferenceNetwork
    assert abs(forecast_of(torch_only, WALK, 5) - kernels).max() < 1e-5


@pytest.mark.parametrize("network", [convgru(20), convgru(20, static_gates=(), resolution_input=True), rnn(20)])
def test_every_tensor_of_a_step_is_on_the_device_of_the_network(network):
    network = network.to("meta")
    state = network.step(torch.zeros(1, 2, 20, 20, device="meta"), network.initial(1))
    state = network.step(None, state)
    logits = network.occupancy(network.features(state))
    assert {one.device.type for one in (logits, *tensors_of(state))} == {"meta"}


@pytest.mark.skipif(torch.accelerator.is_available(), reason="this machine has an accelerator")
@pytest.mark.parametrize("tracker", [*TRACKERS, OneShotTracker])
def test_a_device_that_torch_does_not_have_is_refused_in_a_line(tracker):
    card = general_card(tracker)
    with pytest.raises(ConfigurationError, match=r"^device=cuda: torch .* finds no such device here .in a sandbox"):
        trained(tracker, card, WALK, device="cuda")
    assert trained(tracker, card, WALK, device="auto").device == ""
    assert inference_device("auto") == torch.device("cpu")


def test_a_device_has_its_own_precision():
    network = convgru(20).to("meta")
    with pytest.raises(ConfigurationError, match="inference=bfloat16 needs cell=gru on device=cpu; the device is meta"):
        DilatedConvGRUTracker.prepare_inference(network, DilatedConvGRUTracker.Options(inference="bfloat16"))


@pytest.mark.parametrize(
    ("tracker", "module"),
    [(TRACKERS[0], network_tracker), (TRACKERS[1], network_tracker), (OneShotTracker, one_shot)],
)
def test_a_tracker_names_its_device(monkeypatch, tracker, module):
    monkeypatch.setattr(module, "device_name", lambda device: f"name of {device}")
    assert trained(tracker, general_card(tracker), WALK).device == "name of cpu"
