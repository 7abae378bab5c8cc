"""Horizons in steps: how many frames ahead a forecast is, from the time ahead."""

from __future__ import annotations

TIE_DIGITS = 3
"""Decimals of a number of steps; a period of six digits makes it inexact beyond them."""


def nearest_step(horizon_s: float, period_s: float) -> int:
    """The step nearest to a horizon; of two equally near ones the even.

    Half a second lies between the steps 3 and 4 at 7 Hz: whether the period is 1/7 s or its first digits, it is 4.
    """
    return round(round(horizon_s / period_s, TIE_DIGITS))
