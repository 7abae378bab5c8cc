"""The gates of the ConvGRU and their gradient, each in one pass over memory, for training on a processor.

Written with PyTorch's operations the gates take longer than the convolutions: every operation reads and writes a
state's size. Here the forward pass keeps nothing but its inputs, the backward pass computes the gates anew, and both
read convolutions as bfloat16 where they are.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise
from typing import Any

import numba
import numpy as np
import torch
from numba.extending import overload
from numpy.typing import NDArray
from torch import Tensor

from gridtrack.trackers.recurrent.dilated_convgru import convgru_gates
from gridtrack.trackers.recurrent.fused import FLAGS, activations

AT_ONCE = 100
"""Cells whose gradients wait in the processor's cache until they are written to where they belong."""
_kept = numba.njit(cache=True, nogil=True, fastmath=FLAGS, error_model="numpy")


def differentiable_gates(x: Tensor | None, h_conv: Tensor, biases: tuple[Tensor, ...], h: Tensor) -> Tensor:
    """`dilated_convgru.convgru_gates` with its gradient, equal to 2e-6; on an accelerator it is that itself."""
    if h.device.type != "cpu":
        return convgru_gates(x, h_conv, biases, h)
    new: Tensor = _Gates.apply(x, h_conv, *biases, h)  # type: ignore[no-untyped-call]
    return new


class _Gates(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor | None, h_conv: Tensor, *biases_and_h: Tensor) -> Tensor:
        ctx.save_for_backward(x, h_conv, *biases_and_h)
        *biases, h = biases_and_h
        out = torch.empty_like(h, memory_format=torch.channels_last)
        forward, _ = _kernels(h.shape[1])
        _in_threads(forward, *_operands(x, h_conv, biases, h), _rows(out))
        return out

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        x, h_conv, *biases, h = ctx.saved_tensors
        grad_h_conv, grad_h = (torch.empty_like(t, memory_format=torch.channels_last) for t in (h_conv, h))
        grad_x = None if x is None else torch.empty_like(x, memory_format=torch.channels_last)
        _, channels, *size = h.shape
        grad_maps = h.new_zeros((*size, len(biases) * channels))
        _, backward = _kernels(channels)
        _in_threads(
            backward,
            *_operands(x, h_conv, biases, h),
            _rows(grads[0]),
            None if grad_x is None else _rows(grad_x),
            _rows(grad_h_conv),
            grad_maps.view(-1, grad_maps.shape[-1]).numpy(),
            _rows(grad_h),
        )
        of_biases = (
            grad.permute(2, 0, 1).sum_to_size(bias.shape)
            for grad, bias in zip(torch.split(grad_maps, channels, dim=-1), biases, strict=True)
        )
        return grad_x, grad_h_conv, *of_biases, grad_h


def _operands(x: Tensor | None, h_conv: Tensor, biases: list[Tensor], h: Tensor) -> tuple[Any, ...]:
    """Rows of channels, one for each cell of each item of the batch; of the maps, one for each cell."""
    maps = (_rows(bias.expand(h.shape[1:])[None]) for bias in biases)
    return None if x is None else _rows(x), _rows(h_conv), *maps, _rows(h)


def _rows(tensor: Tensor) -> NDArray[Any]:
    """(B, C, M, M) in channels-last memory as (B * M * M, C), without copying; bfloat16 as its bits in uint16."""
    rows = tensor.detach().permute(0, 2, 3, 1).contiguous().reshape(-1, tensor.shape[1])
    return rows.view(torch.uint16).numpy() if rows.dtype == torch.bfloat16 else rows.numpy()


def _in_threads(kernel: Callable[..., None], x: Any, h_conv: Any, b_keep: Any, *others: Any) -> None:
    """Run `kernel` on as many threads as PyTorch, each on a block of cells.

    Threads of numba's own would share PyTorch's OpenMP, change its number of threads, and wait for it spinning.
    """
    bounds = np.linspace(0, len(b_keep), torch.get_num_threads() + 1).astype(int)
    blocks = list(pairwise(bounds.tolist()))
    run = _threads().map if len(blocks) > 1 else map
    list(run(lambda block: kernel(*block, x, h_conv, b_keep, *others), blocks))


@cache
def _threads() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(thread_name_prefix="gates")


def _read(rows: Any, i: Any, c: Any) -> Any:
    """rows[i, c] as float32; see the overload."""


@overload(_read, inline="always")
def _read_overload(rows, i, c):  # type: ignore[no-untyped-def]
    if rows.dtype == numba.float32:
        return lambda rows, i, c: rows[i, c]
    return lambda rows, i, c: np.int32(np.uint32(rows[i, c]) << np.uint32(16)).view(np.float32)


def _rounded(rows: Any, value: Any) -> Any:
    """`value` as `rows` keeps it: bfloat16 is the nearest, ties to even; see the overload."""


@overload(_rounded, inline="always")
def _rounded_overload(rows, value):  # type: ignore[no-untyped-def]
    if rows.dtype == numba.float32:
        return lambda rows, value: value

    def nearest(rows, value):  # type: ignore[no-untyped-def]
        bits = np.float32(value).view(np.uint32)
        odd = (bits >> np.uint32(16)) & np.uint32(1)
        return np.uint16((bits + np.uint32(0x7FFF) + odd) >> np.uint32(16))

    return nearest


@numba.njit(fastmath=FLAGS, error_model="numpy")
def _gates(x, h_conv, b_keep, b_reset, b_candidate, i, cell, c, channels):  # type: ignore[no-untyped-def]
    """Keep, reset and candidate of one channel of one cell."""
    keep, reset, candidate = b_keep[cell, c], b_reset[cell, c], b_candidate[cell, c]
    if x is not None:
        keep += _read(x, i, c)
        reset += _read(x, i, channels + c)
        candidate += _read(x, i, 2 * channels + c)
    keep += _read(h_conv, i, c)
    reset += _read(h_conv, i, channels + c)
    return activations(keep, reset, candidate, _read(h_conv, i, 2 * channels + c))


@numba.njit(fastmath=FLAGS, error_model="numpy")
def _arguments(  # type: ignore[no-untyped-def]
    first, start, x, h_conv, b_keep, b_reset, b_candidate, h, grad, grad_a, grad_h, channels
):
    """Gradients of the arguments of keep, reset and candidate, and of the candidate's hidden convolution.

    h' = c + f (h - c), c = tanh(a), a = a_x + r a_h, where a_h is that convolution.
    """
    one = np.float32(1.0)
    for k in range(len(grad_a)):
        cell = start + k
        i = first + cell
        for c in range(channels):
            f, r, new = _gates(x, h_conv, b_keep, b_reset, b_candidate, i, cell, c, channels)
            g = grad[i, c]
            g_candidate = g * (one - f) * (one - new * new)
            grad_a[k, c] = g * (h[i, c] - new) * f * (one - f)
            grad_a[k, channels + c] = g_candidate * _read(h_conv, i, 2 * channels + c) * r * (one - r)
            grad_a[k, 2 * channels + c] = g_candidate
            grad_a[k, 3 * channels + c] = g_candidate * r
            grad_h[i, c] = g * f


@numba.njit(fastmath=FLAGS, error_model="numpy")
def _spread(i, start, grad_a, grad_x, grad_h_conv, grad_maps, channels):  # type: ignore[no-untyped-def]
    """A map's gradient is the sum over the batch of those of the arguments, which are the input convolution's."""
    for k in range(len(grad_a)):
        for c in range(3 * channels):
            grad_maps[start + k, c] += grad_a[k, c]
        if grad_x is not None:
            for c in range(3 * channels):
                grad_x[i + k, c] = _rounded(grad_x, grad_a[k, c])
        for c in range(2 * channels):
            grad_h_conv[i + k, c] = _rounded(grad_h_conv, grad_a[k, c])
        for c in range(channels):
            grad_h_conv[i + k, 2 * channels + c] = _rounded(grad_h_conv, grad_a[k, 3 * channels + c])


@cache
def _kernels(channels: int) -> tuple[Callable[..., None], Callable[..., None]]:
    """The passes forwards and backwards, on the cells `start` to `stop` - 1 of every item of the batch.

    The number of channels is written into them, and what they call is compiled with them and not kept apart: only so
    do the loops become vector instructions.
    """

    @_kept
    def forward(start, stop, x, h_conv, b_keep, b_reset, b_candidate, h, out):  # type: ignore[no-untyped-def]
        cells = len(b_keep)
        for first in range(0, len(h), cells):
            for cell in range(start, stop):
                i = first + cell
                for c in range(channels):
                    f, _, new = _gates(x, h_conv, b_keep, b_reset, b_candidate, i, cell, c, channels)
                    out[i, c] = new + f * (h[i, c] - new)

    @_kept
    def backward(  # type: ignore[no-untyped-def]
        start, stop, x, h_conv, b_keep, b_reset, b_candidate, h, grad, grad_x, grad_h_conv, grad_maps, grad_h
    ):
        cells = len(b_keep)
        some = np.empty((AT_ONCE, 4 * channels), np.float32)
        for first in range(0, len(h), cells):
            for at in range(start, stop, AT_ONCE):
                grad_a = some[: min(AT_ONCE, stop - at)]
                _arguments(first, at, x, h_conv, b_keep, b_reset, b_candidate, h, grad, grad_a, grad_h, channels)
                _spread(first + at, at, grad_a, grad_x, grad_h_conv, grad_maps, channels)

    return forward, backward
