"""A score or a difference as text, with its 95 % interval: `0.693 [.670, .713]`, `-0.012 [-.020, -.004]`."""

from __future__ import annotations

import re

from gridtrack.evaluation.runs.summary import PairTest
from gridtrack.reports.differences import SIGNIFICANT as TOLD_APART

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


def pair_text(test: PairTest, decimals: int = 3) -> str:
    """The difference of a pair that was tested, with a mark where the two are not told apart."""
    assert test.difference is not None
    text = score_text(test.difference, test.low, test.high, signed=True, decimals=decimals)
    return chance_marked(text, test.verdict not in TOLD_APART)


def chance_marked(text: str, may_be_chance: bool) -> str:
    """The text of a difference, with MAY_BE_CHANCE behind it where that is so."""
    return f"{text} {MAY_BE_CHANCE}" if may_be_chance else text


def _without_zero(text: str) -> str:
    """`.693`, `1.234` or `-.012`."""
    return re.sub(r"^([+-]?)0\.", r"\1.", text)
