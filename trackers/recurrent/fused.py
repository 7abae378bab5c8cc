"""The element-wise half of the ConvGRU cell as one pass over memory, for inference on a processor.

Written with PyTorch's operations the gates read and write the state's size some twenty times, and cost three times as
much as the convolutions. Here every number is read once, and the exponential is a polynomial that the compiler turns
into vector instructions.
"""

from __future__ import annotations

import math

import numba
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

_LOG2_E = np.float32(1.0 / math.log(2.0))
_TAYLOR = tuple(np.float32(math.log(2.0) ** k / math.factorial(k)) for k in range(7))
"""2^f = sum of _TAYLOR[k] f^k, to 2e-7 for |f| <= 1/2."""
FLAGS = {"contract", "nsz", "arcp"}
_ROWS = numba.float32[:, ::1]


def fused_gates(x: Tensor | None, h_conv: Tensor, biases: tuple[Tensor, ...], h: Tensor) -> Tensor:
    """`dilated_convgru.convgru_gates`, equal to 2e-6, of channels-last float32 tensors with batch 1 and no gradient."""
    out = torch.empty_like(h, memory_format=torch.channels_last)
    cells = h.shape[1:]
    b_keep, b_reset, b_candidate = (_rows(bias.expand(cells)[None]) for bias in biases)
    if x is None:
        _gates_without_input(_rows(h_conv), b_keep, b_reset, b_candidate, _rows(h), _rows(out))
    else:
        _gates(_rows(x), _rows(h_conv), b_keep, b_reset, b_candidate, _rows(h), _rows(out))
    return out


def _rows(tensor: Tensor) -> NDArray[np.float32]:
    """(1, C, M, M) in channels-last memory as (M * M, C): a row of channels for each cell, without copying."""
    rows: NDArray[np.float32] = tensor.detach().permute(0, 2, 3, 1).contiguous().reshape(-1, tensor.shape[1]).numpy()
    return rows


@numba.njit(inline="always", fastmath=FLAGS)
def sigmoid(x):  # type: ignore[no-untyped-def]
    """1 / (1 + 2^t) with t = -x log2 e; 2^t is 2^n, put together from its bits, times a polynomial of the rest."""
    t = min(max(-x * _LOG2_E, np.float32(-126.0)), np.float32(126.0))
    n = np.floor(t + np.float32(0.5))
    f = t - n
    power = _TAYLOR[5] + f * _TAYLOR[6]
    power = _TAYLOR[3] + f * (_TAYLOR[4] + f * power)
    power = _TAYLOR[0] + f * (_TAYLOR[1] + f * (_TAYLOR[2] + f * power))
    two_to_n = np.int32((np.int32(n) + np.int32(127)) << np.int32(23)).view(np.float32)
    return np.float32(1.0) / (np.float32(1.0) + power * two_to_n)


@numba.njit(inline="always", fastmath=FLAGS)
def _cell(keep, reset, candidate, candidate_h, h):  # type: ignore[no-untyped-def]
    """h' of one channel of one cell; tanh(a) = 2 sigmoid(2 a) - 1."""
    a = candidate + sigmoid(reset) * candidate_h
    c = np.float32(2.0) * sigmoid(a + a) - np.float32(1.0)
    return c + sigmoid(keep) * (h - c)


# With their signatures the kernels are compiled when a tracker's process starts, and not in its first update.
@numba.njit([(_ROWS,) * 7], cache=True, nogil=True, fastmath=FLAGS, error_model="numpy")
def _gates(x, h_conv, b_keep, b_reset, b_candidate, h, out):  # type: ignore[no-untyped-def]
    cells, channels = h.shape
    for i in range(cells):
        for c in range(channels):
            r, k = channels + c, 2 * channels + c
            out[i, c] = _cell(
                x[i, c] + h_conv[i, c] + b_keep[i, c],
                x[i, r] + h_conv[i, r] + b_reset[i, c],
                x[i, k] + b_candidate[i, c],
                h_conv[i, k],
                h[i, c],
            )


@numba.njit([(_ROWS,) * 6], cache=True, nogil=True, fastmath=FLAGS, error_model="numpy")
def _gates_without_input(h_conv, b_keep, b_reset, b_candidate, h, out):  # type: ignore[no-untyped-def]
    cells, channels = h.shape
    for i in range(cells):
        for c in range(channels):
            out[i, c] = _cell(
                h_conv[i, c] + b_keep[i, c],
                h_conv[i, channels + c] + b_reset[i, c],
                b_candidate[i, c],
                h_conv[i, 2 * channels + c],
                h[i, c],
            )
