"""Horizons in steps."""

from __future__ import annotations

import pytest

from gridtrack.common.grid import nearest_step


@pytest.mark.parametrize(
    ("rate_hz", "horizon_s", "step"),
    [(10.0, 0.5, 5), (7.5, 0.5, 4), (7.5, 1.0, 8), (5.0, 0.5, 2), (7.0, 0.5, 4), (20.0, 2.5, 50), (3.0, 0.1, 0)],
)
def test_the_nearest_step_is_the_same_for_a_period_and_for_its_first_digits(rate_hz, horizon_s, step):
    assert nearest_step(horizon_s, 1 / rate_hz) == step
    assert nearest_step(horizon_s, round(1 / rate_hz, 6)) == step
