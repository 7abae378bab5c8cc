"""Figures place every score by its axis; undefined scores are gaps; labels do not overlap."""

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gridtrack.evaluation.results.passes import Latency, Quantiles
from gridtrack.reports.figures import ROW_HEIGHT, Axis, Series, curve_panel, time_scale
from gridtrack.reports.recording_section import keeps_up

HORIZONS_S = (0.0, 0.5, 1.0, 1.5)


def panel(*curves, label_width=100.0):
    series = [(Series(f"s{i}", f"t{i}"), curve) for i, curve in enumerate(curves)]
    return curve_panel("dynamic", HORIZONS_S, series, (740, 460), label_width)


def points(text):
    return [tuple(map(float, pair.split(","))) for pair in text.split()]


def test_a_curve_goes_through_its_scores():
    drawn = panel((1.0, 0.75, 0.5, 0.0))
    height = drawn.y.start - drawn.y.end
    for (x, y), horizon, value in zip(points(drawn.lines[0].pieces[0]), HORIZONS_S[1:], (0.75, 0.5, 0.0), strict=True):
        assert x == pytest.approx(drawn.x.start + horizon / 1.5 * (drawn.x.end - drawn.x.start), abs=0.06)
        assert (drawn.y.start - y) / height == pytest.approx(value, abs=0.06 / height)


def test_step_0_is_drawn_separately():
    line = panel((1.0, 0.75, 0.5, 0.0)).lines[0]
    assert line.at_zero == points(line.to_zero)[0]
    assert points(line.to_zero)[1] == points(line.pieces[0])[0]


def test_an_undefined_score_is_a_gap_and_not_a_zero():
    line = panel((1.0, 0.8, None, 0.6)).lines[0]
    assert [len(points(piece)) for piece in line.pieces] == [1, 1]
    assert not panel((None, None, None, None)).lines[0].pieces


@given(st.lists(st.floats(0, 1), min_size=1, max_size=12))
def test_labels_keep_their_order_and_do_not_overlap(ends):
    drawn = panel(*((0.5, 0.5, 0.5, end) for end in ends))
    labels = sorted((line.label_at[2], line.label_at[1]) for line in drawn.lines)
    heights = [y for _, y in labels]
    assert heights == sorted(heights)
    assert all(b - a >= ROW_HEIGHT - 0.11 for a, b in pairwise(heights))


def test_a_reading_lists_the_best_first_with_its_value():
    reading = panel((1.0, 0.25, 0.5, 0.0), (1.0, 0.75, None, 0.0)).readings
    assert [(s.name, text) for s, text, _, _ in reading[1].rows] == [("s1", "0.750"), ("s0", "0.250")]
    assert [s.name for s, *_ in reading[2].rows] == ["s0"]
    assert "not ranked" in reading[0].heading


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
