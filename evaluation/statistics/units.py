"""Statistical units: whole recordings, or blocks of time longer than the autocorrelation of the frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.statistics.jackknife import LEAST_UNITS, TOO_SHORT

BLOCK_TIMES = 10.0
"""Length of a block in autocorrelation times: the means of neighbouring blocks are then nearly independent."""
SHORTEST_BLOCK_S = 100.0
"""The shortest block, seconds, at any measured correlation: longer than people stay and than most cycles of traffic
lights. A short recording does not show its longer memory."""
WINDOW = 5.0
"""The autocorrelation is summed up to a lag of this many times the sum itself (Sokal 1997, section 3)."""
UPPER_QUANTILE = 1.645
"""Standard errors of the autocorrelation time that are added to it: a one-sided limit of 95 %."""


@dataclass(frozen=True, slots=True)
class UnitRule:
    """How the frames of several recordings are divided into units.

    `sources` has the source of each recording, such as its hash: recordings, and stretches of recordings, of one source
    are one recording here. `block_s` is the shortest block, seconds; None: each source is one unit.
    """

    sources: tuple[str, ...]
    block_s: float | None

    def units_of(self, stamps_ns: Sequence[NDArray[np.int64]]) -> list[NDArray[np.int64]]:
        """The unit of every scored frame, per recording (F,), counted through all of them; stamps (F,) increase.

        Without `block_s` a unit is a source. Else each source is divided into as many equal blocks of at least
        `block_s` as possible, in the time that its stretches cover together; one that covers less is one unit.
        """
        units = [np.zeros(len(stamps), np.int64) for stamps in stamps_ns]
        first = 0
        for source in dict.fromkeys(self.sources):
            own = [i for i, name in enumerate(self.sources) if name == source and len(stamps_ns[i])]
            own.sort(key=lambda i: int(stamps_ns[i][0]))
            if not own:
                continue
            blocks = _blocks([stamps_ns[i] for i in own], self.block_s)
            for i, block in zip(own, np.split(blocks, np.cumsum([len(stamps_ns[i]) for i in own])[:-1]), strict=True):
                units[i] = first + block
            first += int(blocks[-1]) + 1
        return units

    def too_short(self, units: int) -> str:
        """The reason why there is no interval, for fewer than LEAST_UNITS units, and the missing data."""
        sources = len(set(self.sources))
        of_them = f", of {sources} recording{'s' * (sources != 1)}" if len(self.sources) > sources else ""
        missing = LEAST_UNITS - sources
        recordings = f"{missing} more recording{'s' * (missing != 1)}"
        if units == sources > 1:
            return f"{TOO_SHORT}: {units} recordings, and {LEAST_UNITS} units are needed: {recordings}"
        more = f", or about {(LEAST_UNITS - units) * self.block_s / 60:.0f} more minutes" if self.block_s else ""
        blocks = f", blocks of at least {self.block_s:.3g} s" if self.block_s else ""
        return (
            f"{TOO_SHORT}: {units} unit{'s' * (units != 1)}{of_them}{blocks}, and {LEAST_UNITS} are needed:"
            f" {recordings}{more}"
        )


def enough_sources(sources: Sequence[str]) -> bool:
    """Whether there are so many different sources that each is a unit."""
    return len(set(sources)) >= LEAST_UNITS


def shortest_block_s(correlated_s: float, cycle_s: float | None) -> float:
    """The shortest block, seconds, for an autocorrelation time and the longest cycle of the sites."""
    return max(SHORTEST_BLOCK_S, cycle_s or 0.0, BLOCK_TIMES * correlated_s)


def autocorrelation_time(series: NDArray[np.float64]) -> float:
    """Upper limit of the integrated autocorrelation time of series (F, ...), in samples, the longest of them.

    The time is 1 + 2 sum of the autocorrelations up to a lag of WINDOW times that sum, 1 for independent samples;
    UPPER_QUANTILE of its standard errors, sqrt(2 (2 lag + 1) / F) of itself, are added (Sokal, Monte Carlo methods in
    statistical mechanics, 1997, equations 3.16 to 3.20). A constant series has 1.
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
    found = np.maximum(times[lag, np.arange(times.shape[1])], 1.0)
    return float((found * (1 + UPPER_QUANTILE * np.sqrt(2 * (2 * lag + 1) / len(series)))).max())


def residuals(part: NDArray[np.float64], whole: NDArray[np.float64]) -> NDArray[np.float64]:
    """Linearised contribution (F, ...) of each frame's sums to the ratio of their totals."""
    total = whole.sum(axis=0)
    ratio = np.divide(part.sum(axis=0), total, out=np.zeros_like(total), where=total > 0)
    moved: NDArray[np.float64] = part - ratio * whole
    return moved


def _blocks(stamps_ns: Sequence[NDArray[np.int64]], block_s: float | None) -> NDArray[np.int64]:
    """The block of each frame (F,) of the stretches of one source, in their order, counted without gaps."""
    frames = sum(map(len, stamps_ns))
    if block_s is None or frames < 2:
        return np.zeros(frames, np.int64)
    at_s, lasts_s = [], 0.0
    for stamps in stamps_ns:
        since_s = (stamps - stamps[0]) / 1e9
        at_s.append(lasts_s + since_s)
        lasts_s += float(since_s[-1]) + (float(np.median(np.diff(since_s))) if len(stamps) > 1 else 0.0)
    blocks = min(max(1, int(lasts_s / block_s + 1e-9)), frames) if lasts_s else 1
    block = (np.concatenate(at_s) / max(lasts_s, 1e-9) * blocks).astype(np.int64)
    return np.unique(np.minimum(block, blocks - 1), return_inverse=True)[1].astype(np.int64)
