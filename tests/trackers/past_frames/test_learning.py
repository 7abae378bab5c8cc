"""Each peer learns a few windows by heart: it forecasts where the dot goes, which no floor does."""

from __future__ import annotations

import pytest

torch = pytest.importorskip("torch")

from gridtrack.common.config import validated  # noqa: E402
from gridtrack.trackers.past_frames.simvp import SimVPTracker  # noqa: E402
from gridtrack.trackers.past_frames.sogmp import SOGMPTracker  # noqa: E402
from gridtrack.trackers.recurrent.conv_lstm import ConvLSTMTracker  # noqa: E402
from gridtrack.trackers.recurrent.fit import start_from_rate  # noqa: E402
from gridtrack.trackers.recurrent.sequences import SequenceDataset  # noqa: E402
from gridtrack.trackers.recurrent.training_module import sequence_loss  # noqa: E402
from tests.trackers.recurrent.sources import Shuttle  # noqa: E402

SMALL = {
    ConvLSTMTracker: ({"channels": 8, "blank_frames": 2}, 0.01, 60),
    SimVPTracker: ({"channels": 4, "hidden": 16, "blocks": 2, "blank_frames": 3}, 0.02, 80),
    SOGMPTracker: ({"channels": 16, "hidden": 32, "blank_frames": 1}, 0.005, 140),
}
"""Options of a small network, its learning rate and the number of updates."""


@pytest.mark.parametrize("kind", SMALL)
def test_it_forecasts_a_moving_dot(kind):
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
