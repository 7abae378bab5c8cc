"""Drawings place every value by their axis; what keeps up follows from the times."""

import pytest

from gridtrack.evaluation.runs.passes import Quantiles
from gridtrack.reports.figures import Axis
from gridtrack.reports.times import keeps_up


def test_an_axis_clamps_values_beyond_its_ends():
    axis = Axis(0.0, 1.0, 100.0, 0.0)
    assert (axis(-1.0), axis(0.25), axis(2.0)) == (100.0, 75.0, 0.0)


@pytest.mark.parametrize(
    ("update", "predict", "verdict"),
    [(4.0, 40.0, "yes"), (50.0, 60.0, "updates only"), (101.0, 1.0, "no")],
)
def test_a_tracker_keeps_up_when_update_and_forecast_fit_into_the_period(update, predict, verdict):
    times = [Quantiles(p50=0.1, p95=0.2, p99=ms) for ms in (update, predict)]
    assert keeps_up(*times, 100.0) == verdict
