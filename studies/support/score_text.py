"""A score or a difference as text, with its 95 % interval: `0.693 [.670, .713]`, `-0.012 [-.020, -.004]`."""

from __future__ import annotations

import re

MAY_BE_CHANCE = "°"
"""Stands behind a difference whose corrected p-value is 0.05 or more."""


def score_text(
    value: float, low: float | None = None, high: float | None = None, *, signed: bool = False, decimals: int = 3
) -> str:
    """The score, with its interval where that is known."""
    shown = f"{'+' if signed else ''}.{decimals}f"
    text = format(value, shown)
    if low is None or high is None:
        return text
    return f"{text} [{', '.join(_without_zero(format(end, shown)) for end in (low, high))}]"


def _without_zero(text: str) -> str:
    """`.693`, `1.234` or `-.012`."""
    return re.sub(r"^([+-]?)0\.", r"\1.", text)
