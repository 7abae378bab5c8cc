"""The gates of the ConvGRU and their gradient, each in one pass over memory, for training on a processor.

Written with PyTorch's operations the gates take longer than the convolutions: every operation reads and writes a
state's size. Here the forward pass keeps nothing but its inputs, the backward pass computes the gates anew, and both
read convolutions as bfloat16 where they are.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import torch
from numba.extending import overload
from numpy.typing import NDArray
from torch import Tensor

from gridtrack.trackers.recurrent.dilated_convgru import convgru_gates
from gridtrack.trackers.recurrent.fused import FLAGS, sigmoid


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
        _with_threads_of_torch()
        _forward(*_operands(x, h_conv, biases, h), _rows(out))
        return out

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        x, h_conv, *biases, h = ctx.saved_tensors
        grad_h_conv, grad_h = (torch.empty_like(t, memory_format=torch.channels_last) for t in (h_conv, h))
        grad_x = None if x is None else torch.empty_like(x, memory_format=torch.channels_last)
        grad_biases = [_map_like(h) for _ in biases]
        _with_threads_of_torch()
        _backward(
            *_operands(x, h_conv, biases, h),
            _rows(grads[0]),
            _rows(grad_h_conv if grad_x is None else grad_x),
            _rows(grad_h_conv),
            *(_rows(grad[None]) for grad in grad_biases),
            _rows(grad_h),
        )
        summed = (grad.sum_to_size(bias.shape) for grad, bias in zip(grad_biases, biases, strict=True))
        return grad_x, grad_h_conv, *summed, grad_h


def _operands(x: Tensor | None, h_conv: Tensor, biases: list[Tensor], h: Tensor) -> tuple[Any, ...]:
    """Rows of channels for each cell; where there is no input, none."""
    maps = (_rows(bias.expand(h.shape[1:])[None]) for bias in biases)
    rows = _rows(h_conv)
    return (rows[:0] if x is None else _rows(x)), rows, *maps, _rows(h)


def _map_like(h: Tensor) -> Tensor:
    """An unfilled map (C, M, M), channels last."""
    _, channels, *size = h.shape
    return h.new_empty((*size, channels)).permute(2, 0, 1)


def _rows(tensor: Tensor) -> NDArray[Any]:
    """(B, C, M, M) in channels-last memory as (B * M * M, C), without copying; bfloat16 as its bits in uint16."""
    rows = tensor.detach().permute(0, 2, 3, 1).contiguous().reshape(-1, tensor.shape[1])
    return rows.view(torch.uint16).numpy() if rows.dtype == torch.bfloat16 else rows.numpy()


def _with_threads_of_torch() -> None:
    numba.set_num_threads(min(torch.get_num_threads(), numba.config.NUMBA_NUM_THREADS))  # type: ignore[attr-defined]


def _read(rows: Any, i: Any, c: Any) -> Any:
    """rows[i, c] as float32; see the overload."""


@overload(_read, inline="always")
def _read_overload(rows, i, c):  # type: ignore[no-untyped-def]
    if rows.dtype == numba.float32:
        return lambda rows, i, c: rows[i, c]
    return lambda rows, i, c: np.int32(np.uint32(rows[i, c]) << np.uint32(16)).view(np.float32)


def _write(rows: Any, i: Any, c: Any, value: Any) -> Any:
    """rows[i, c] = value, rounded to the nearest, ties to even; see the overload."""


@overload(_write, inline="always")
def _write_overload(rows, i, c, value):  # type: ignore[no-untyped-def]
    if rows.dtype == numba.float32:

        def write(rows, i, c, value):  # type: ignore[no-untyped-def]
            rows[i, c] = value

    else:

        def write(rows, i, c, value):  # type: ignore[no-untyped-def]
            bits = np.float32(value).view(np.uint32)
            rows[i, c] = np.uint16(
                (bits + np.uint32(0x7FFF) + ((bits >> np.uint32(16)) & np.uint32(1))) >> np.uint32(16)
            )

    return write


@numba.njit(cache=True, nogil=True, parallel=True, fastmath=FLAGS, error_model="numpy")
def _forward(x, h_conv, b_keep, b_reset, b_candidate, h, out):  # type: ignore[no-untyped-def]
    cells, channels = b_keep.shape
    for i in numba.prange(h.shape[0]):
        cell = i % cells
        for c in range(channels):
            keep, reset, candidate = b_keep[cell, c], b_reset[cell, c], b_candidate[cell, c]
            if len(x):
                keep += _read(x, i, c)
                reset += _read(x, i, channels + c)
                candidate += _read(x, i, 2 * channels + c)
            f = sigmoid(keep + _read(h_conv, i, c))
            r = sigmoid(reset + _read(h_conv, i, channels + c))
            a = candidate + r * _read(h_conv, i, 2 * channels + c)
            new = np.float32(2.0) * sigmoid(a + a) - np.float32(1.0)
            out[i, c] = new + f * (h[i, c] - new)


@numba.njit(cache=True, nogil=True, parallel=True, fastmath=FLAGS, error_model="numpy")
def _backward(  # type: ignore[no-untyped-def]
    x, h_conv, b_keep, b_reset, b_candidate, h, grad, grad_x, grad_h_conv, g_keep, g_reset, g_candidate, grad_h
):
    """With a the argument of a gate: h' = c + f (h - c), c = tanh(a_c), a_c = candidate + r candidate_h.

    A map's gradient is the sum over the batch of those of the arguments, which are the input convolution's too.
    """
    one = np.float32(1.0)
    cells, channels = b_keep.shape
    batch = h.shape[0] // cells
    for cell in numba.prange(cells):
        for b in range(batch):
            i = b * cells + cell
            for c in range(channels):
                keep, reset, candidate = b_keep[cell, c], b_reset[cell, c], b_candidate[cell, c]
                if len(x):
                    keep += _read(x, i, c)
                    reset += _read(x, i, channels + c)
                    candidate += _read(x, i, 2 * channels + c)
                candidate_h = _read(h_conv, i, 2 * channels + c)
                f = sigmoid(keep + _read(h_conv, i, c))
                r = sigmoid(reset + _read(h_conv, i, channels + c))
                a = candidate + r * candidate_h
                new = np.float32(2.0) * sigmoid(a + a) - one

                g = grad[i, c]
                g_k = g * (h[i, c] - new) * f * (one - f)
                g_c = g * (one - f) * (one - new * new)
                g_r = g_c * candidate_h * r * (one - r)
                grad_h[i, c] = g * f
                _write(grad_x, i, 2 * channels + c, g_c)
                _write(grad_x, i, c, g_k)
                _write(grad_x, i, channels + c, g_r)
                _write(grad_h_conv, i, c, g_k)
                _write(grad_h_conv, i, channels + c, g_r)
                _write(grad_h_conv, i, 2 * channels + c, g_c * r)
                if b == 0:
                    g_keep[cell, c], g_reset[cell, c], g_candidate[cell, c] = g_k, g_r, g_c
                else:
                    g_keep[cell, c] += g_k
                    g_reset[cell, c] += g_r
                    g_candidate[cell, c] += g_c
