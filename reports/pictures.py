"""Pictures of grids: row 0 at the bottom, x to the right, y up, one pixel per cell."""

from __future__ import annotations

import base64
import struct
import zlib
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import Mask

SHADES = 65
"""Number of shades of probability from 0 to 1: finer than the eye resolves."""
UNOBSERVED = SHADES
"""Palette index of cells that are not visible."""
UNOBSERVED_RGB = (198, 200, 204)

# White (certainly free) to near black (certainly occupied) by way of yellow, red and violet, as OKLCH: equal steps of
# probability are equal steps of lightness, and the hue separates a medium probability from the neutral grey.
_LIGHTNESS = (1.0, 0.18)
_CHROMA = ((0.0, 0.1, 0.3, 0.55, 0.8, 1.0), (0.0, 0.085, 0.15, 0.17, 0.12, 0.04))
_HUE_DEG = ((0.0, 0.1, 0.3, 0.55, 0.8, 1.0), (90.0, 84.0, 60.0, 22.0, -20.0, -60.0))


def probability_png(probability: NDArray[np.float32]) -> str:
    """A forecast (M, M) float32 in [0, 1] as a PNG data address."""
    levels = np.rint(np.clip(probability, 0.0, 1.0) * (SHADES - 1))
    return _png(np.asarray(levels, np.uint8))


def frame_png(visible: Mask, occupied: Mask) -> str:
    """A frame, `visible` and `occupied` (M, M) bool, as a PNG data address; cells that are not visible are grey."""
    levels = np.where(visible, np.where(occupied, SHADES - 1, 0), UNOBSERVED)
    return _png(levels.astype(np.uint8))


def scale_png() -> str:
    """The colours of probability 0 to 1 from left to right, one pixel high, as a PNG data address."""
    return _png(np.arange(SHADES, dtype=np.uint8)[None])


def _png(levels: NDArray[np.uint8]) -> str:
    """Palette picture of `levels` (rows, columns), row 0 at the bottom (PNG specification, third edition)."""
    rows, columns = levels.shape
    lines = np.pad(levels[::-1], ((0, 0), (1, 0)))  # a leading 0 in each line: no filter
    header = struct.pack(">IIBBBBB", columns, rows, 8, 3, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"PLTE", palette().tobytes()), (b"IDAT", zlib.compress(lines.tobytes(), 9)))
    blob = b"\x89PNG\r\n\x1a\n" + b"".join(_png_chunk(kind, content) for kind, content in (*chunks, (b"IEND", b"")))
    return "data:image/png;base64," + base64.b64encode(blob).decode()


def _png_chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


@lru_cache(maxsize=1)
def palette() -> NDArray[np.uint8]:
    """Colours (SHADES + 1, 3) sRGB: the probabilities 0 to 1, then not visible."""
    p = np.linspace(0.0, 1.0, SHADES)
    hue = np.deg2rad(np.interp(p, *_HUE_DEG))
    chroma = np.interp(p, *_CHROMA)
    lab = np.stack([np.interp(p, (0.0, 1.0), _LIGHTNESS), chroma * np.cos(hue), chroma * np.sin(hue)], axis=1)
    return np.vstack([_srgb_of_oklab(lab), np.array([UNOBSERVED_RGB], np.uint8)])


def _srgb_of_oklab(lab: NDArray[np.float64]) -> NDArray[np.uint8]:
    """OKLab (N, 3) to sRGB (N, 3) (Ottosson 2020, "A perceptual color space for image processing")."""
    to_lms = np.array(
        [[1, 0.3963377774, 0.2158037573], [1, -0.1055613458, -0.0638541728], [1, -0.0894841775, -1.291485548]]
    )
    to_linear = np.array(
        [
            [4.0767416621, -3.3077115913, 0.2309699292],
            [-1.2684380046, 2.6097574011, -0.3413193965],
            [-0.0041960863, -0.7034186147, 1.707614701],
        ]
    )
    linear = np.clip((lab @ to_lms.T) ** 3 @ to_linear.T, 0.0, 1.0)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.asarray(np.rint(encoded * 255.0), np.uint8)
