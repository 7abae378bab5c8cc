"""Values of a score relative to those of other rows: the share of the way from the best floor to the oracle."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce

import numpy as np

from gridtrack.evaluation.scores.definition import CurvesByStratum, Floats


def share_of_oracle(
    own: CurvesByStratum,
    floors: Sequence[CurvesByStratum],
    oracle: CurvesByStratum | None,
    best: Callable[[Floats, Floats], Floats],
    least_gap: float,
    *,
    relative: bool = False,
) -> CurvesByStratum:
    """(value - floor) / (oracle - floor) by stratum (S,), of the best floor at each step; NaN where it is not known.

    `best` is fmax or fmin. A share is not known without oracle or floors, and where the oracle is not better than the
    floor by `least_gap`, as a share of the floor's value where `relative`.
    """
    shares: dict[str, Floats] = {}
    for stratum, value in own.items():
        shares[stratum] = np.full(value.shape, np.nan)
        known = [floor[stratum] for floor in floors if stratum in floor]
        if oracle is None or stratum not in oracle or not known or len(known) < len(floors):
            continue
        floor = reduce(best, known)
        gap = oracle[stratum] - floor
        clear = np.abs(gap) >= least_gap * (np.where(floor > 0, floor, np.inf) if relative else 1.0)
        clear &= np.sign(gap) == (1.0 if best is np.fmax else -1.0)
        np.divide(value - floor, gap, out=shares[stratum], where=clear)
    return shares
