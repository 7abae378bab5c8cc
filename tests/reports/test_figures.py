"""Figures place every value by its axis."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gridtrack.evaluation.results.passes import Latency, Quantiles
from gridtrack.reports.figures import Axis, time_scale
from gridtrack.reports.recording_section import keeps_up


@given(st.floats(0.02, 9e3), st.floats(0.02, 9e3))
def test_the_time_axis_is_logarithmic_and_marks_the_period(time_ms, period_ms):
    scale = time_scale([time_ms], period_ms, 200.0)
    at = scale.axis(time_ms)
    assert 6.0 <= at <= 194.0
    decade = scale.ticks[1][0] - scale.ticks[0][0]
    assert at - scale.period == pytest.approx(decade * math.log10(time_ms / period_ms), abs=0.4)


def test_an_axis_clamps_values_beyond_its_ends():
    axis = Axis(0.0, 1.0, 100.0, 0.0)
    assert (axis(-1.0), axis(0.25), axis(2.0)) == (100.0, 75.0, 0.0)


@pytest.mark.parametrize(
    ("update", "predict", "verdict"),
    [(4.0, 40.0, "yes"), (50.0, 60.0, "updates only"), (101.0, 1.0, "no")],
)
def test_a_tracker_keeps_up_when_update_and_forecast_fit_into_the_period(update, predict, verdict):
    times = {call: Quantiles(p50=0.1, p95=0.2, p99=ms) for call, ms in (("update", update), ("predict", predict))}
    assert keeps_up(Latency(**times, predict_step=times["predict"]), 100.0) == verdict
