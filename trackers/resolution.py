"""Cell size and period of a grid stream as inputs of a network for any place."""

from __future__ import annotations

import math

UNIT_CELL_M, UNIT_PERIOD_S = 0.1, 0.1
"""The cell size and the period at which the inputs are 0."""


def cell_input(cell_m: float) -> float:
    """log2 of the cell size in UNIT_CELL_M."""
    return math.log2(cell_m / UNIT_CELL_M)


def period_input(period_s: float) -> float:
    """log2 of the period in UNIT_PERIOD_S."""
    return math.log2(period_s / UNIT_PERIOD_S)
