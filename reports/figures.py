"""Drawings in SVG: positions of values in its user units, colours, and the document."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Axis:
    """A linear or logarithmic map from values [low, high] to positions [start, end]."""

    low: float
    high: float
    start: float
    end: float
    logarithmic: bool = False

    def __call__(self, value: float) -> float:
        """Position of `value`, clamped to the axis, rounded to a tenth of a unit."""
        low, high, value = (math.log(v) if self.logarithmic else v for v in (self.low, self.high, max(value, self.low)))
        share = (value - low) / (high - low)
        return round(self.start + min(max(share, 0.0), 1.0) * (self.end - self.start), 1)


def document(width: float, height: float, parts: Sequence[str], font_size: int) -> str:
    """`parts` on a white page of this size."""
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" font-family="sans-serif"'
        f' font-size="{font_size}"><rect width="100%" height="100%" fill="white"/>{"".join(parts)}</svg>\n'
    )
