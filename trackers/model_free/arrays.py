"""Types of the arrays that the pipeline works with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""Double precision; each function states the shape and the unit."""
