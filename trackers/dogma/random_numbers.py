"""Random numbers in compiled kernels: a counter hashed by SplitMix64, normal deviates from a table of quantiles.

Steele, Lea and Flood, "Fast splittable pseudorandom number generators" (OOPSLA 2014). The counter is the only state:
the same counter gives the same numbers.
"""

from __future__ import annotations

import numba
import numpy as np
from scipy.special import ndtri

_QUANTILES = 4096
NORMAL = ndtri((np.arange(_QUANTILES) + 0.5) / _QUANTILES).astype(np.float32)
"""Equally probable values of a standard normal deviate; the largest is 3.7."""

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1, _MIX_2 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_30, _27, _31 = np.uint64(30), np.uint64(27), np.uint64(31)
_INDEX = np.uint64(_QUANTILES - 1)
_48 = np.uint64(48)
_UNIT = np.float32(2.0**-16)


def random_stream(seed: int, number: int) -> np.uint64:
    """The first counter (uint64) of stream `number` of `seed`; consecutive streams are 2**40 draws apart."""
    start = int(hashed(np.uint64(seed % 2**64))) + number * 2**40 * int(_GOLDEN)
    return np.uint64(start % 2**64)


@numba.njit(error_model="numpy")
def hashed(counter):  # type: ignore[no-untyped-def]
    """64 random bits of a counter, both uint64."""
    z = (counter ^ (counter >> _30)) * _MIX_1
    z = (z ^ (z >> _27)) * _MIX_2
    return z ^ (z >> _31)


@numba.njit(error_model="numpy")
def next_counter(counter):  # type: ignore[no-untyped-def]
    """The next counter."""
    return counter + _GOLDEN


@numba.njit(error_model="numpy")
def normal(bits, number):  # type: ignore[no-untyped-def]
    """A standard normal deviate, float32: `number` 0, 1, 2 or 3, each from 12 bits of its own."""
    return NORMAL[(bits >> np.uint64(12 * number)) & _INDEX]


@numba.njit(error_model="numpy")
def uniform(bits):  # type: ignore[no-untyped-def]
    """A multiple of 2**-16 in [0, 1), float32, from bits 48 to 63, independent of the normal deviates."""
    return np.float32(bits >> _48) * _UNIT
