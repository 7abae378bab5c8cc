"""Values of a score relative to other rows: the share of the way from the best floor to the oracle."""

from __future__ import annotations

import numpy as np

from gridtrack.evaluation.scores.definition import CurvesByStratum, Floats


def share_of_oracle(
    own: CurvesByStratum,
    floor: CurvesByStratum | None,
    oracle: CurvesByStratum | None,
    direction: int,
    least_gap: float,
    *,
    relative: bool = False,
) -> CurvesByStratum:
    """(value - floor) / (oracle - floor) by stratum (S,); NaN if it is not known.

    `direction`: 1 where higher values are better, -1 where lower ones are. A share is not known without oracle or
    floor, and where the oracle is not better than the floor by `least_gap`, as a share of the floor's value where
    `relative`.
    """
    shares: dict[str, Floats] = {}
    for stratum, value in own.items():
        shares[stratum] = np.full(value.shape, np.nan)
        if floor is None or oracle is None or stratum not in floor or stratum not in oracle:
            continue
        start = floor[stratum]
        gap = oracle[stratum] - start
        least = least_gap * (np.where(start > 0, start, np.inf) if relative else 1.0)
        np.divide(value - start, gap, out=shares[stratum], where=direction * gap >= least)
    return shares
