"""Times of a call."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray


def times_ms(
    call: Callable[[], object], runs: int, prepare: Callable[[], object] = lambda: None
) -> NDArray[np.float64]:
    """Milliseconds (runs,) of `call`, after one run that is not counted; `prepare` runs before each, untimed."""
    spent = np.empty(runs + 1)
    for run in range(runs + 1):
        prepare()
        began = time.perf_counter()
        call()
        spent[run] = time.perf_counter() - began
    return 1e3 * spent[1:]


def median_ms(call: Callable[[], object], runs: int, prepare: Callable[[], object] = lambda: None) -> float:
    """The median of `times_ms`."""
    return float(np.median(times_ms(call, runs, prepare)))


def p50_p95(values: Sequence[float] | NDArray[np.float64], digits: int = 1) -> str:
    """`1.2 / 3.4`: the median and the 95th percentile."""
    p50, p95 = np.percentile(np.asarray(values), [50, 95])
    return f"{p50:.{digits}f} / {p95:.{digits}f}"
