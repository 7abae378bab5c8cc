"""How often each cell of a site is occupied while it is visible, counted with a prior."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

PRIOR_FRAMES = 20.0
"""Weight of the base rate against a cell's own record, in frames."""


def posterior_rate(counted: NDArray[np.float64], visible: NDArray[np.float64]) -> NDArray[np.float32]:
    """Posterior mean (M, M) of counts (M, M) in so many visible frames (M, M).

    The Beta prior is worth PRIOR_FRAMES frames, and its mean is the base rate, the share of all visible cells: a cell
    never seen, or never seen occupied, keeps a small probability and not zero.
    """
    base_rate = counted.sum() / max(visible.sum(), 1.0)
    return np.asarray((counted + PRIOR_FRAMES * base_rate) / (visible + PRIOR_FRAMES), np.float32)
