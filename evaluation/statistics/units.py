"""Statistical units: whole recordings, or blocks of time longer than the autocorrelation of the frames."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.statistics.jackknife import LEAST_UNITS

BLOCK_TIMES = 10.0
"""Length of a block in autocorrelation times: the means of neighbouring blocks are then nearly independent."""
WINDOW = 5.0
"""The autocorrelation is summed up to a lag of this many times the sum itself (Sokal 1997, section 3)."""


def autocorrelation_time(series: NDArray[np.float64]) -> float:
    """Integrated autocorrelation time of series (F, ...), in samples, the longest of them: 1 for independent samples.

    1 + 2 sum of the autocorrelations up to a lag of WINDOW times that sum (Sokal, Monte Carlo methods in statistical
    mechanics, 1997). A constant series has 1.
    """
    columns = series.reshape(len(series), -1)
    centred = columns - columns.mean(axis=0)
    size = 2 * len(centred)
    power = np.abs(np.fft.rfft(centred, size, axis=0)) ** 2
    covariance = np.fft.irfft(power, size, axis=0)[: len(centred)]
    varying = covariance[0] > 1e-12 * len(centred)
    if not varying.any():
        return 1.0
    times = 2 * (covariance[:, varying] / covariance[0, varying]).cumsum(axis=0) - 1
    reached = np.arange(len(times))[:, None] >= WINDOW * times
    lag = np.where(reached.any(axis=0), reached.argmax(axis=0), len(times) - 1)
    return float(max(1.0, times[lag, np.arange(times.shape[1])].max()))


def residuals(part: NDArray[np.float64], whole: NDArray[np.float64]) -> NDArray[np.float64]:
    """Linearised contribution (F, ...) of each frame's sums to the ratio of their totals."""
    total = whole.sum(axis=0)
    ratio = np.divide(part.sum(axis=0), total, out=np.zeros_like(total), where=total > 0)
    moved: NDArray[np.float64] = part - ratio * whole
    return moved


def units_of(stamps_ns: Sequence[NDArray[np.int64]], block_s: float) -> list[NDArray[np.int64]]:
    """The unit of every scored frame, per recording (F,), counted through all of them.

    Twenty recordings or more are the units themselves. Of fewer, each is divided into as many equal blocks of time, of
    at least `block_s`, as possible; a recording shorter than that, or of a single frame, is one unit.
    """
    whole = len(stamps_ns) >= LEAST_UNITS
    units, first = [], 0
    for stamps in stamps_ns:
        cut = np.zeros(len(stamps), np.int64) if whole else _blocks(stamps, block_s)
        units.append(first + cut)
        first += int(cut[-1]) + 1 if len(cut) else 0
    return units


def _blocks(stamps_ns: NDArray[np.int64], block_s: float) -> NDArray[np.int64]:
    if len(stamps_ns) < 2:
        return np.zeros(len(stamps_ns), np.int64)
    since_s = (stamps_ns - stamps_ns[0]) / 1e9
    lasts_s = float(since_s[-1]) + float(np.median(np.diff(since_s)))
    blocks = min(max(1, int(lasts_s / block_s + 1e-9)), len(stamps_ns))
    block = (since_s / lasts_s * blocks).astype(np.int64)
    return np.unique(block, return_inverse=True)[1].astype(np.int64)


def sum_by_unit(counts: NDArray[np.floating], units: NDArray[np.int64]) -> NDArray[np.float64]:
    """Counts (F, ...) of frames summed over each unit, in their order; `units` (F,) do not decrease."""
    starts = np.flatnonzero(np.diff(units, prepend=-1))
    summed: NDArray[np.float64] = np.add.reduceat(counts, starts, axis=0, dtype=np.float64)
    return summed
