"""A recurrent tracker that did not receive some frames has the state of one that received empty ones in their place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from gridtrack.common.geometry import SE2  # noqa: E402
from gridtrack.common.grid import GridFrame, GridSpec  # noqa: E402
from gridtrack.trackers.contract import StreamSpec  # noqa: E402
from gridtrack.trackers.recurrent.convgru_tracker import DilatedConvGRUTracker  # noqa: E402
from gridtrack.trackers.recurrent.dilated_convgru import DilatedConvGRU  # noqa: E402
from gridtrack.trackers.recurrent.network import channels_last  # noqa: E402
from gridtrack.trackers.recurrent.recurrent_tracker import MOST_MISSED  # noqa: E402
from gridtrack.trackers.recurrent.settings import DilatedConvGRUOptions  # noqa: E402

SIZE, PERIOD_S = 15, 0.1


def tracker():
    torch.manual_seed(3)
    options = DilatedConvGRUOptions()
    network = channels_last(DilatedConvGRU(SIZE, options).eval()).requires_grad_(requires_grad=False)
    stream = StreamSpec(GridSpec(SIZE, 0.5), PERIOD_S)
    return DilatedConvGRUTracker(stream, options, DilatedConvGRUTracker.prepare_inference(network, options))


def frames(count):
    """Frames at the stamps of a stream that begins at a day's time, with random content."""
    drawn = np.random.default_rng(5).random((count, 2, SIZE, SIZE)) < 0.4
    none, stamps = np.zeros((0, 2), np.float32), 1_700_000_000_000_000_000 + np.arange(count) * 100_000_000
    return [
        GridFrame(int(stamp), visible, visible & occupied, SE2(), none, none, np.zeros(0, np.uint8))
        for stamp, (visible, occupied) in zip(stamps, drawn, strict=True)
    ]


def forecast_after(given):
    one = tracker()
    for frame in given:
        one.update(frame)
    return one.predict(3).occupancy


def test_missed_frames_are_steps_without_input():
    stream = frames(8)
    missed = {2, 3, 6}
    nothing = np.zeros((SIZE, SIZE), bool)
    emptied = [replace(f, visible=nothing, occupied=nothing) if k in missed else f for k, f in enumerate(stream)]
    received = [f for k, f in enumerate(stream) if k not in missed]
    np.testing.assert_array_equal(forecast_after(received), forecast_after(emptied))
    assert abs(forecast_after(received) - forecast_after(stream)).max() > 1e-3


def test_a_tracker_that_is_too_slow_for_its_stream_catches_up_on_a_bounded_number_of_frames():
    first, *_, last = frames(3 * MOST_MISSED)
    near = replace(last, stamp_ns=first.stamp_ns + (MOST_MISSED + 1) * 100_000_000)
    np.testing.assert_array_equal(forecast_after([first, last]), forecast_after([first, near]))
