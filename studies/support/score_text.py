"""A score or a difference as text, with its 95 % interval: `0.693 [.670, .713]`, `-0.012 [-.020, -.004]`."""

from __future__ import annotations

import re

MAY_BE_CHANCE = "°"
"""Stands behind a difference whose corrected p-value is 0.05 or more."""


def score_text(value: float, low: float | None = None, high: float | None = None, *, signed: bool = False) -> str:
    """Three decimals; the interval where it is known."""
    text = _decimals(value, signed=signed)
    if low is None or high is None:
        return text
    return f"{text} [{', '.join(_without_zero(_decimals(end, signed=signed)) for end in (low, high))}]"


def _decimals(value: float, *, signed: bool) -> str:
    return f"{value:+.3f}" if signed else f"{value:.3f}"


def _without_zero(text: str) -> str:
    """`.693`, `1.234` or `-.012`."""
    return re.sub(r"^([+-]?)0\.", r"\1.", text)
