"""The occupancy rate of each cell of a site: counts with a Beta prior."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

PRIOR_FRAMES = 20.0
"""Weight of the prior, in frames."""


def posterior_rate(counted: NDArray[np.float64], visible: NDArray[np.float64]) -> NDArray[np.float32]:
    """Posterior mean (M, M) float32 of the rate of the `counted` (M, M) among the `visible` frames (M, M) of each cell.

    The Beta prior has the weight of PRIOR_FRAMES frames and the mean rate of all visible cells, so that a cell that was
    never seen, or never seen occupied, has a small positive probability.
    """
    base_rate = counted.sum() / max(visible.sum(), 1.0)
    return np.asarray((counted + PRIOR_FRAMES * base_rate) / (visible + PRIOR_FRAMES), np.float32)
