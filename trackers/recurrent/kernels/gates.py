"""The element-wise half of the ConvGRU cell as one pass over memory, on a processor; for training with its gradient.

With PyTorch's operations the gates read and write the whole state about twenty times and take three times as long as
the convolutions. Here every number is read once, and the exponential is a polynomial, which the compiler vectorises. In
training the forward pass stores the gates for the backward pass, which sums the gradients of the static memory over all
steps. Both read and write bfloat16 convolutions without conversion.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any

import numba
import numpy as np
import torch
from numba.extending import overload
from numpy.typing import NDArray
from torch import Tensor

Rows = NDArray[Any]
"""(B * M * M, N): one row of channels for each cell; bfloat16 as its bits in uint16."""

CACHED_CELLS = 100
"""Cells per band: their static memory stays in the processor's cache for all items of the batch."""
_LOG2_E = np.float32(1.0 / math.log(2.0))
_TAYLOR = tuple(np.float32(math.log(2.0) ** k / math.factorial(k)) for k in range(7))
"""2^f = sum of _TAYLOR[k] f^k, to 2e-7 for |f| <= 1/2."""
_ROUNDER = np.float32(1.5 * 2**23)
"""The sum of this and a small number has the nearest integer in its last bits."""
FLAGS = {"contract", "nsz", "arcp"}


_compiled = numba.njit(cache=True, nogil=True, fastmath=FLAGS, error_model="numpy")


def kernel(signature: str) -> Any:
    """A decorator that compiles at definition: when the tracker's process starts, not in its first update."""
    return numba.njit(signature, cache=True, nogil=True, fastmath=FLAGS, error_model="numpy")


def widened(value: Any) -> Any:
    """`value` as float32, from float32 or from the bits of a bfloat16 in a uint16."""


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

    tanh(a) = 2 sigmoid(2 a) - 1.
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


class StaticMemory:
    """The three biases of one layer, (C, M, M) or (C, 1, 1) each, and their gradient over the steps of a sequence.

    Each step adds to `gradient` (M, M, 3C); a sum by autograd would write and read it twice more a step. `token`
    represents the biases in autograd's graph.
    """

    def __init__(self, biases: tuple[Tensor, ...], size: int) -> None:
        channels = len(biases[0])
        self.maps = tuple(_rows(bias.detach().expand(channels, size, size)[None]) for bias in biases)
        self.gradient = biases[0].new_zeros((size, size, len(biases) * channels))
        self.token: Tensor = _SumOfSteps.apply(self.gradient, *biases)  # type: ignore[no-untyped-call]


def differentiable_gates(
    x: Tensor | None, h_conv: Tensor, memory: StaticMemory, h: Tensor
) -> tuple[Tensor, Tensor | None]:
    """`dilated_convgru.convgru_gates` with its gradient: h' in float32, and in bfloat16 if `h_conv` is bfloat16.

    The error of h' and its gradients is below 2e-6 in float32; with bfloat16 the stored gates have an error of 8e-6.
    """
    new: tuple[Tensor, Tensor | None] = _Gates.apply(memory.token, memory, x, h_conv, h)  # type: ignore[no-untyped-call]
    return new


class _SumOfSteps(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, gradient: Tensor, *biases: Tensor) -> Tensor:
        ctx.gradient, ctx.shapes = gradient, [bias.shape for bias in biases]
        return gradient.new_zeros(())

    @staticmethod
    def backward(ctx: Any, *_: Tensor) -> tuple[Tensor | None, ...]:
        of_biases = ctx.gradient.permute(2, 0, 1).chunk(len(ctx.shapes))
        return None, *(grad.sum_to_size(shape) for grad, shape in zip(of_biases, ctx.shapes, strict=True))


class _Gates(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, token: Tensor, memory: StaticMemory, x: Tensor | None, h_conv: Tensor, h: Tensor
    ) -> tuple[Tensor, Tensor | None]:
        half = h_conv.dtype == torch.bfloat16
        new = torch.empty_like(h, memory_format=torch.channels_last)
        rounded = torch.empty_like(new, dtype=torch.bfloat16) if half else None
        gates = torch.empty_like(h_conv, dtype=torch.uint16 if half else None, memory_format=torch.channels_last)
        _in_threads(_forward_kernel(h.shape[1]), memory.maps, *map(_rows, (x, h_conv, h, gates, new, rounded)))
        ctx.save_for_backward(h_conv, h, gates)
        ctx.memory, ctx.with_input = memory, x is not None
        return new, rounded

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        h_conv, h, gates = ctx.saved_tensors
        grad_h_conv, grad_h = (torch.empty_like(t, memory_format=torch.channels_last) for t in (h_conv, h))
        grad_x = torch.empty_like(grad_h_conv) if ctx.with_input else None
        gradient = ctx.memory.gradient.flatten(0, 1).numpy()
        rows = map(_rows, (h_conv, h, gates, *grads, grad_x, grad_h_conv, grad_h))
        _in_threads(_backward_kernel(h.shape[1]), (gradient,), *rows)
        return h.new_zeros(()), None, grad_x, grad_h_conv, grad_h


def _rows(tensor: Tensor | None) -> Any:
    """(B, C, M, M) in channels-last memory as Rows, without copying."""
    if tensor is None:
        return None
    rows = tensor.detach().permute(0, 2, 3, 1).contiguous().reshape(-1, tensor.shape[1])
    return rows.view(torch.uint16).numpy() if rows.dtype == torch.bfloat16 else rows.numpy()


def _in_threads(kernel: Callable[..., None], maps: tuple[Rows, ...], *rows: Any) -> None:
    """Run `kernel` on as many threads as PyTorch, each on a block of cells.

    Numba's own threads share PyTorch's OpenMP: they would change its number of threads, and wait in a busy loop.
    """
    bounds = np.linspace(0, len(maps[0]), torch.get_num_threads() + 1).astype(int)
    blocks = list(pairwise(bounds.tolist()))
    run = _threads().map if len(blocks) > 1 else map
    list(run(lambda block: kernel(*block, *maps, *rows), blocks))


@functools.cache
def _threads() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(thread_name_prefix="gates")


def _rounded(rows: Any, value: Any) -> Any:
    """`value` in the type of `rows`; bfloat16 is rounded to nearest, ties to even."""


@overload(_rounded, inline="always")
def _rounded_overload(rows, value):  # type: ignore[no-untyped-def]
    if rows.dtype == numba.float32:
        return lambda rows, value: value

    def nearest(rows, value):  # type: ignore[no-untyped-def]
        bits = np.float32(value).view(np.uint32)
        odd = (bits >> np.uint32(16)) & np.uint32(1)
        return np.uint16((bits + np.uint32(0x7FFF) + odd) >> np.uint32(16))

    return nearest


def _quantised(gates: Any, value: Any) -> Any:
    """A gate in [0, 1] in the type of `gates`: float32, or uint16 in 65535ths; bfloat16 is too coarse near 1."""


@overload(_quantised, inline="always")
def _quantised_overload(gates, value):  # type: ignore[no-untyped-def]
    if gates.dtype == numba.float32:
        return lambda gates, value: value
    return lambda gates, value: np.uint16(np.int32(value * np.float32(65535.0) + np.float32(0.5)))


def _dequantised(gate: Any) -> Any:
    """The float32 gate that `_quantised` stored as `gate`."""


@overload(_dequantised, inline="always")
def _dequantised_overload(gate):  # type: ignore[no-untyped-def]
    if gate == numba.float32:
        return lambda gate: gate
    return lambda gate: np.float32(np.int32(gate)) * np.float32(1.0 / 65535.0)


@functools.cache
def _forward_kernel(channels: int) -> Callable[..., None]:
    """The forward pass over the cells `start` to `stop` - 1 of every item of the batch.

    The number of channels is a constant of the compiled code, and its functions are inlined: otherwise the loops are
    not vectorised. The candidate is stored as (1 + c) / 2.
    """
    one, half = np.float32(1.0), np.float32(0.5)

    @_compiled
    def forward(start, stop, b_keep, b_reset, b_candidate, x, h_conv, h, gates, new, rounded):  # type: ignore[no-untyped-def]
        for at in range(start, stop, CACHED_CELLS):
            for first in range(0, len(h), len(b_keep)):
                for cell in range(at, min(at + CACHED_CELLS, stop)):
                    i = first + cell
                    for c in range(channels):
                        keep, reset, candidate = b_keep[cell, c], b_reset[cell, c], b_candidate[cell, c]
                        if x is not None:
                            keep += widened(x[i, c])
                            reset += widened(x[i, channels + c])
                            candidate += widened(x[i, 2 * channels + c])
                        keep += widened(h_conv[i, c])
                        reset += widened(h_conv[i, channels + c])
                        f, r, a = activations(keep, reset, candidate, widened(h_conv[i, 2 * channels + c]))
                        gates[i, c] = _quantised(gates, f)
                        gates[i, channels + c] = _quantised(gates, r)
                        gates[i, 2 * channels + c] = _quantised(gates, half * (one + a))
                        new[i, c] = a + f * (h[i, c] - a)
                        if rounded is not None:
                            rounded[i, c] = _rounded(rounded, new[i, c])

    return forward


@functools.cache
def _backward_kernel(channels: int) -> Callable[..., None]:
    """The backward pass over the same cells; `gradient`: of the memory, `grad...`: of the results and arguments."""
    one, two = np.float32(1.0), np.float32(2.0)

    @_compiled
    def backward(  # type: ignore[no-untyped-def]
        start, stop, gradient, h_conv, h, gates, grad, grad_rounded, grad_x, grad_h_conv, grad_h
    ):
        for at in range(start, stop, CACHED_CELLS):
            for first in range(0, len(h), len(gradient)):
                for cell in range(at, min(at + CACHED_CELLS, stop)):
                    i = first + cell
                    for c in range(channels):
                        f, r = _dequantised(gates[i, c]), _dequantised(gates[i, channels + c])
                        a = two * _dequantised(gates[i, 2 * channels + c]) - one
                        g = grad[i, c]
                        if grad_rounded is not None:
                            g += widened(grad_rounded[i, c])
                        keep = g * (h[i, c] - a) * f * (one - f)  # gradients of the activations' arguments
                        candidate = g * (one - f) * (one - a * a)
                        reset = candidate * widened(h_conv[i, 2 * channels + c]) * r * (one - r)
                        grad_h[i, c] = g * f
                        gradient[cell, c] += keep
                        gradient[cell, channels + c] += reset
                        gradient[cell, 2 * channels + c] += candidate
                        if grad_x is not None:
                            grad_x[i, c] = _rounded(grad_x, keep)
                            grad_x[i, channels + c] = _rounded(grad_x, reset)
                            grad_x[i, 2 * channels + c] = _rounded(grad_x, candidate)
                        grad_h_conv[i, c] = _rounded(grad_h_conv, keep)
                        grad_h_conv[i, channels + c] = _rounded(grad_h_conv, reset)
                        grad_h_conv[i, 2 * channels + c] = _rounded(grad_h_conv, candidate * r)

    return backward
