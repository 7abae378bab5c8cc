"""A network with the plain interface, without kernels, trains, tracks and moves: the ConvLSTM with its nested state."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("lightning")

from gridtrack.trackers.recurrent.conv_lstm import ConvLSTMTracker  # noqa: E402
from gridtrack.trackers.recurrent.network import map_state, tensors_of  # noqa: E402
from gridtrack.trackers.training.weights import read_card  # noqa: E402
from tests.trackers.recurrent.sources import (  # noqa: E402
    Drive,
    Walk,
    constant,
    fit,
    forecast_of,
    frame_of,
    log_loss_of,
    trained,
)

TINY = {"layers": 2, "channels": 3}


def test_it_trains_and_forecasts(tmp_path):
    card = tmp_path / "drive.toml"
    lines = fit(ConvLSTMTracker, card, [Drive(speed=0)], updates=2, objective=log_loss_of, learning_rate=0.05, **TINY)
    assert [line.split()[1] for line in lines if line.startswith("update")] == ["1", "2"]
    assert (read_card(card).tracker, read_card(card).settings["updates"]) == ("conv-lstm", 2)
    occupancy = forecast_of(trained(ConvLSTMTracker, card, Drive()), Drive(20, start=30), 3)
    assert occupancy.shape == (4, 12, 12)
    assert 0.0 < occupancy.min() < occupancy.max() < 1.0


def test_it_is_trained_for_any_place_and_follows_a_sensor_that_moves_at_any_period(tmp_path):
    """Periods of one, two and half a step; when the window moves beyond itself, every cell is an unseen one."""
    card = tmp_path / "general.toml"
    fit(ConvLSTMTracker, card, [Walk(12, 0.2, 0.1), Walk(10, 0.1, 0.2)], general=True, **TINY)
    for period_s in (0.1, 0.2, 0.05):
        source = Walk(13, 0.2, period_s, frames=5, drift=1)
        tracker = trained(ConvLSTMTracker, card, source)
        constant(tracker, source, 3)
        nothing = np.zeros((13, 13), bool)
        tracker.update(frame_of(nothing, nothing, stamp_s=5 * period_s, cell_m=0.2, column=99))
        never = trained(ConvLSTMTracker, card, source)
        for t in range(6):
            never.update(frame_of(nothing, nothing, stamp_s=t * period_s, cell_m=0.2))
        centre = (slice(None), slice(4, 9), slice(4, 9))
        np.testing.assert_allclose(tracker.predict(0).occupancy[centre], never.predict(0).occupancy[centre], atol=1e-5)


def test_a_cell_keeps_its_state_at_its_place_in_the_world(tmp_path):
    card = tmp_path / "drive.toml"
    fit(ConvLSTMTracker, card, [Drive()], **TINY)
    tracker = trained(ConvLSTMTracker, card, Drive())
    forecast_of(tracker, Drive(5, start=30), 0)
    rolled = tracker.network.rolled(tracker.state, (0, 2), 5)
    unseen = map_state(torch.from_numpy, tracker.network.unseen(5))
    assert len(list(tensors_of(rolled))) == 4
    for old, new, fill in zip(*map(tensors_of, (tracker.state, rolled, unseen)), strict=True):
        assert torch.equal(new[..., :-2], old[..., 2:])
        assert torch.equal(new[0, :, 3, -1], fill)
