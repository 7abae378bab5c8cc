"""The element-wise half of the ConvGRU cell as one pass over memory, for inference on a processor.

With PyTorch's operations the gates read and write the whole state about twenty times and take three times as long as
the convolutions. Here every number is read once, and the exponential is a polynomial, which the compiler vectorises.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numba.extending import overload

_LOG2_E = np.float32(1.0 / math.log(2.0))
_TAYLOR = tuple(np.float32(math.log(2.0) ** k / math.factorial(k)) for k in range(7))
"""2^f = sum of _TAYLOR[k] f^k, to 2e-7 for |f| <= 1/2."""
_ROUNDER = np.float32(1.5 * 2**23)
"""Added to a small number, its sum has the nearest integer in the last bits."""
FLAGS = {"contract", "nsz", "arcp"}


def kernel(signature: str) -> Any:
    """A decorator that compiles at definition: when the tracker's process starts, not in its first update."""
    return numba.njit(signature, cache=True, nogil=True, fastmath=FLAGS, error_model="numpy")


def widened(value: Any) -> Any:
    """`value` as float32, from float32 or from the bits of a bfloat16 in a uint16; see the overload."""


@overload(widened, inline="always")
def _widened_overload(value):  # type: ignore[no-untyped-def]
    if value == numba.float32:
        return lambda value: value
    return lambda value: np.int32(np.uint32(value) << np.uint32(16)).view(np.float32)


@numba.njit(inline="always", fastmath=FLAGS)
def sigmoid(x):  # type: ignore[no-untyped-def]
    """1 / (1 + 2^t) with t = -x log2 e; 2^t is a polynomial of t - n, n added to its exponent's bits."""
    t = min(max(-x * _LOG2_E, np.float32(-126.0)), np.float32(126.0))
    rounded = t + _ROUNDER
    f = t - (rounded - _ROUNDER)
    power = _TAYLOR[5] + f * _TAYLOR[6]
    power = _TAYLOR[3] + f * (_TAYLOR[4] + f * power)
    power = _TAYLOR[0] + f * (_TAYLOR[1] + f * (_TAYLOR[2] + f * power))
    n = np.int32(np.float32(rounded).view(np.int32) << np.int32(23))
    two_to_t = np.int32(np.float32(power).view(np.int32) + n).view(np.float32)
    return np.float32(1.0) / (np.float32(1.0) + two_to_t)


@numba.njit(fastmath=FLAGS)
def activations(keep, reset, candidate, candidate_h):  # type: ignore[no-untyped-def]
    """Keep gate, reset gate and candidate of one channel of one cell, from the arguments of their activations.

    tanh(a) = 2 sigmoid(2 a) - 1. Compiled with its callers, here and in differentiable.py.
    """
    f, r = sigmoid(keep), sigmoid(reset)
    a = candidate + r * candidate_h
    return f, r, np.float32(2.0) * sigmoid(a + a) - np.float32(1.0)


@numba.njit(fastmath=FLAGS)
def _cell(keep, reset, candidate, candidate_h, h):  # type: ignore[no-untyped-def]
    """h' of one channel of one cell."""
    f, _, c = activations(keep, reset, candidate, candidate_h)
    return c + f * (h - c)


@functools.cache
def fused_gates(channels: int, *, with_input: bool, bfloat16: bool = False) -> Callable[..., None]:
    """`dilated_convgru.convgru_gates`, with an error below 2e-6, on some rows of the grid: the kernel

        gates(sums, top, step, map_cells, keep, reset, candidate, h, out)

    `sums` (rows, M or more, N) are the convolutions of rows `top`, `top + step`, ...: C channels each for keep and
    reset, of input and state together; the candidate's of the state; and, `with_input`, the candidate's of the input;
    float32, or the bits of `bfloat16` in uint16. `map_cells` (M, M) int32 is the row of each cell in the biases, which
    are (R, C); `h` and `out` are (M, M, C). C is a constant of the kernel: otherwise its loops are not vectorised.
    """

    sums_type = f"{'uint16' if bfloat16 else 'float32'}[:,:,::1]"
    biases, states = 3 * ["float32[:,::1]"], 2 * ["float32[:,:,::1]"]

    @kernel(f"void({', '.join([sums_type, 'int64', 'int64', 'int32[:,::1]', *biases, *states])})")
    def gates(sums, top, step, map_cells, keep, reset, candidate, h, out):  # type: ignore[no-untyped-def]
        for i in range(sums.shape[0]):
            r = top + i * step
            for x in range(h.shape[1]):
                m = map_cells[r, x]
                for c in range(channels):
                    out[r, x, c] = _cell(
                        widened(sums[i, x, c]) + keep[m, c],
                        widened(sums[i, x, channels + c]) + reset[m, c],
                        candidate[m, c] + (widened(sums[i, x, 3 * channels + c]) if with_input else np.float32(0.0)),
                        widened(sums[i, x, 2 * channels + c]),
                        h[r, x, c],
                    )

    compiled: Callable[..., None] = gates
    return compiled
