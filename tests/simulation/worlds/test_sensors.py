"""Lasers of the worlds: rates as recorded ones have them, whatever the laser."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("shapely", reason="the simulators are not installed")
from gridtrack.simulation.worlds.sensors import draw_sensor


@pytest.mark.parametrize("outdoors", [False, True])
def test_lasers_of_every_kind_are_recorded_slowly_and_fast(outdoors: bool) -> None:
    random = np.random.default_rng(1)
    drawn = [draw_sensor(random, outdoors) for _ in range(600)]
    assert all(5.0 <= one.rate_hz <= 20.0 for one in drawn)
    for far in (False, True):  # to 80 m: a SICK LMS 200, whose recordings aces and intel have 5 and 6.25 Hz
        rates = np.array([one.rate_hz for one in drawn if (one.laser.range_max > 60.0) == far])
        assert 0.1 < (rates < 7.5).mean() < 0.6
        assert (rates > 10.0).mean() > 0.15
