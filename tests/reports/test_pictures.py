"""Pictures show grids with row 0 at the bottom, x to the right and y up, in the shades of the palette."""

import base64
import io

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from gridtrack.reports.pictures import SHADES, UNOBSERVED, frame_png, palette, probability_png

PIL = pytest.importorskip("PIL.Image", reason="pillow, of the extra dev, is not installed")


def decoded(address):
    """Palette indices (rows, columns) of a picture, top line first, and its palette (colours, 3)."""
    head, _, data = address.partition(",")
    assert head == "data:image/png;base64"
    picture = PIL.open(io.BytesIO(base64.b64decode(data, validate=True)))
    assert (picture.format, picture.mode) == ("PNG", "P")
    return np.array(picture), np.array(picture.getpalette()).reshape(-1, 3)


def test_cell_0_0_is_the_bottom_left_pixel_and_columns_run_right():
    probability = np.zeros((3, 3), np.float32)
    probability[0, 0], probability[0, 1], probability[2, 2] = 1.0, 0.5, 0.25
    pixels, _ = decoded(probability_png(probability))
    top = SHADES - 1
    assert pixels.tolist() == [[0, 0, top // 4], [0, 0, 0], [top, top // 2, 0]]


def test_a_frame_shows_free_occupied_and_unobserved():
    visible = np.array([[True, True], [False, True]])
    occupied = np.array([[True, False], [False, False]])
    pixels, colours = decoded(frame_png(visible, occupied))
    assert pixels.tolist() == [[UNOBSERVED, 0], [SHADES - 1, 0]]
    assert colours[0].tolist() == [255, 255, 255]
    assert colours[SHADES - 1].max() < 50
    assert len(set(colours[UNOBSERVED].tolist())) <= 3 < colours[UNOBSERVED].min()


@given(arrays(np.float32, st.tuples(st.just(7), st.just(7)), elements=st.floats(0, 1, width=32)))
def test_any_forecast_survives_to_the_nearest_shade(probability):
    pixels, _ = decoded(probability_png(probability))
    assert np.abs(pixels[::-1] / (SHADES - 1) - probability).max() <= 0.5 / (SHADES - 1) + 1e-6


def test_more_probable_is_always_darker_in_equal_steps():
    linear = (palette()[:SHADES] / 255.0) ** 2.2
    lightness = np.cbrt(linear @ np.array([0.2126, 0.7152, 0.0722]))
    steps = -np.diff(lightness)
    assert (steps > 0).all()
    assert steps.max() < 4 * np.median(steps)
