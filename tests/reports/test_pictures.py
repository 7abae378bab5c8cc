"""Pictures show grids with row 0 at the bottom, x to the right and y up, in the shades of the palette."""

import base64
import struct
import zlib

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from gridtrack.reports.pictures import SHADES, UNOBSERVED, frame_png, palette, probability_png, scale_png


def decoded(address):
    """Palette indices (rows, columns) of a picture, top line first, and its palette: read by the PNG specification."""
    head, _, data = address.partition(",")
    assert head == "data:image/png;base64"
    blob = base64.b64decode(data, validate=True)
    assert blob[:8] == b"\x89PNG\r\n\x1a\n"
    chunks, at = {}, 8
    while at < len(blob):
        (length,) = struct.unpack(">I", blob[at : at + 4])
        kind, content = blob[at + 4 : at + 8], blob[at + 8 : at + 8 + length]
        assert struct.unpack(">I", blob[at + 8 + length : at + 12 + length]) == (zlib.crc32(kind + content),)
        chunks[kind] = content
        at += 12 + length
    width, height, depth, colour, *rest = struct.unpack(">IIBBBBB", chunks[b"IHDR"])
    assert (depth, colour, rest) == (8, 3, [0, 0, 0])
    lines = np.frombuffer(zlib.decompress(chunks[b"IDAT"]), np.uint8).reshape(height, width + 1)
    assert not lines[:, 0].any()
    return lines[:, 1:], np.frombuffer(chunks[b"PLTE"], np.uint8).reshape(-1, 3)


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


def test_the_scale_runs_from_free_to_occupied():
    pixels, _ = decoded(scale_png())
    assert pixels.tolist() == [list(range(SHADES))]
