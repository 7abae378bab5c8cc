"""Percentiles of any number of calls, accurate to 1 %, in bounded memory."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from gridtrack.evaluation.hosting.timing import Latencies


@given(st.lists(st.floats(1e-3, 1e5), min_size=1, max_size=200), st.sampled_from([50, 95, 99]))
def test_percentiles_agree_with_sorting(times: list[float], percent: int) -> None:
    latencies = Latencies()
    for ms in times:
        latencies.add(ms)
    exact = np.percentile(times, percent, method="inverted_cdf")
    assert abs(latencies.percentile(percent) - exact) <= 0.0101 * exact


def test_times_beyond_the_scale_are_counted_at_its_ends() -> None:
    latencies = Latencies()
    assert math.isnan(latencies.percentile(50))
    latencies.add(0.0)
    latencies.add(1e9)
    assert len(latencies) == 2
    assert latencies.percentile(50) <= 1.02e-3
    assert latencies.max_ms == 1e9
