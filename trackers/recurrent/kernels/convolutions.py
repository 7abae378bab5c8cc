"""Convolutions for inference on a processor, in float32 by Winograd's F(4x4, 3x3): a quarter of the multiplications.

    Y = A^T [ (G g G^T) o (B^T d B) ] A

is the output of 4x4 cells of a 3x3 filter g on a 6x6 tile d, with 36 multiplications instead of 144 (Lavin and Gray,
Fast Algorithms for Convolutional Neural Networks, 2016). Summed over channels, these are 36 matrix products. A
convolution of dilation d is d x d dense convolutions, each on every d-th row and column; the tiles are arranged so.

A band of a few rows of tiles is processed at a time, so that intermediate results stay in the second-level cache.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numba
import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import conv2d

from gridtrack.trackers.recurrent.kernels.gates import FLAGS, kernel
from gridtrack.trackers.recurrent.network import Float32Array, as_cells, as_tensor

Kernel = Callable[[Float32Array, int, Float32Array], None]
"""Called with an input array, a dilation and the output array."""

TILE = 4
"""Output cells of a tile along each axis; its input has one more on every side."""
BAND_TILES = 2
"""Rows of tiles in a band: enough for fast matrix products, few enough for the cache."""
G = (
    (1 / 4, 0, 0),
    (-1 / 6, -1 / 6, -1 / 6),
    (-1 / 6, 1 / 6, -1 / 6),
    (1 / 24, 1 / 12, 1 / 6),
    (1 / 24, -1 / 12, 1 / 6),
    (0, 0, 1),
)


class WinogradConvolution:
    """The sum of the 3x3 convolutions of several images, each with its own filters; one dilation, zero padding."""

    def __init__(self, weight: Tensor, channels: Sequence[int], size: int, dilation: int) -> None:
        """`weight` (N, sum of `channels`, 3, 3); image k is (`size`, `size`, `channels[k]`)."""
        outputs, inputs = weight.shape[:2]
        self.size, self.dilation = size, dilation
        self._filters = transformed_filters(weight)
        across = dilation * math.ceil(math.ceil(size / dilation) / TILE)
        tiles, products = (torch.zeros(36 * BAND_TILES * across * each) for each in (inputs, outputs))
        self._bands = [_Band.within(tiles, products, rows, across) for rows in self._rows()]
        self._sums = np.zeros((TILE * BAND_TILES, TILE * across, outputs), np.float32)
        seen = (TILE * BAND_TILES + 2, TILE * across + 2 * dilation)
        self._padded = [np.zeros((*seen, each), np.float32) for each in channels]
        self._transforms = [tile_transform(each, sum(channels[:k])) for k, each in enumerate(channels)]
        self._inverse = inverse_transform(outputs)

    def bands(self, images: Sequence[Float32Array]) -> Iterator[tuple[range, Float32Array]]:
        """Rows of the result and their sums (rows, `size` or more, N), valid until the next band; every row once."""
        for band in self._bands:
            for image, padded, transform in zip(images, self._padded, self._transforms, strict=True):
                pad(image, band.rows.start, self.dilation, padded)
                transform(padded, self.dilation, band.tile_grid)
            torch.bmm(band.tiles, self._filters, out=band.products)
            self._inverse(band.product_grid, self.dilation, self._sums)
            yield band.rows, self._sums[: len(band.rows)]

    def _rows(self) -> Iterator[range]:
        """The rows of each band: every d-th row, from each of the first d rows on."""
        height = TILE * BAND_TILES * self.dilation
        for phase in range(min(self.dilation, self.size)):
            for top in range(phase, self.size, height):
                yield range(top, min(top + height, self.size), self.dilation)


@dataclass(frozen=True, slots=True)
class _Band:
    """Some rows, and buffers of their T tiles (36, T, K) and products (36, T, N); the grids are (6, 6, T, .) views."""

    rows: range
    tiles: Tensor
    products: Tensor
    tile_grid: Float32Array
    product_grid: Float32Array

    @classmethod
    def within(cls, tiles: Tensor, products: Tensor, rows: range, across: int) -> _Band:
        """A band in the buffers that all bands share, with `across` tiles in a row."""
        count = math.ceil(len(rows) / TILE) * across
        t, p = (
            buffer[: buffer.numel() * count // (BAND_TILES * across)].view(36, count, -1)
            for buffer in (tiles, products)
        )
        return cls(rows, t, p, t.view(6, 6, count, -1).numpy(), p.view(6, 6, count, -1).numpy())


def transformed_filters(weight: Tensor) -> Tensor:
    """G g G^T of the filters `weight` (N, K, 3, 3), as 36 matrices (36, K, N)."""
    g = torch.tensor(G, dtype=torch.float64)
    filters: Tensor = torch.einsum("ia,nkab,jb->ijkn", g, weight.double(), g)
    return filters.flatten(0, 1).float().contiguous()


@numba.njit(inline="always", fastmath=FLAGS)
def _b_transposed(d0, d1, d2, d3, d4, d5):  # type: ignore[no-untyped-def]
    """B^T d of one column of a tile."""
    two, four, five = np.float32(2.0), np.float32(4.0), np.float32(5.0)
    even, odd = d4 - four * d2, d3 - four * d1
    near, far = d4 - d2, two * (d3 - d1)
    return four * d0 - five * d2 + d4, even + odd, even - odd, near + far, near - far, four * d1 - five * d3 + d5


@numba.njit(inline="always", fastmath=FLAGS)
def _a_transposed(m0, m1, m2, m3, m4, m5):  # type: ignore[no-untyped-def]
    """A^T m of one column of a tile's products."""
    two, four, eight = np.float32(2.0), np.float32(4.0), np.float32(8.0)
    even, odd = m1 + m2, m1 - m2
    far_even, far_odd = m3 + m4, m3 - m4
    return m0 + even + far_even, odd + two * far_odd, even + four * far_even, odd + eight * far_odd + m5


@numba.njit(inline="always")
def _tile_corner(tile, across, dilation):  # type: ignore[no-untyped-def]
    """Row in the band and column of a tile's first cell; `across` tiles are in a row."""
    row, column = divmod(tile, across)
    return TILE * row, TILE * dilation * (column // dilation) + column % dilation


@kernel("void(float32[:,:,::1], int64, int64, float32[:,:,::1])")
def pad(image, top, dilation, padded):  # type: ignore[no-untyped-def]
    """Fill `padded` with every d-th row of `image`, the first one above row `top`, with zero padding."""
    size, _, channels = image.shape
    for i in range(padded.shape[0]):
        row = top + (i - 1) * dilation
        if 0 <= row < size:
            line, seen = padded[i].reshape(-1)[dilation * channels :], image[row].reshape(-1)
            for k in range(len(seen)):
                line[k] = seen[k]
        else:
            padded[i] = np.float32(0.0)


# The number of channels is a constant of these kernels: otherwise the loops over channels are not vectorised.
@functools.cache
def tile_transform(channels: int, offset: int) -> Kernel:
    """The kernel of B^T d B: from a padded image (rows, columns, C) to `tiles` (6, 6, T, K), columns `offset` on."""

    @kernel("void(float32[:,:,::1], int64, float32[:,:,:,::1])")
    def transform(padded, dilation, tiles):  # type: ignore[no-untyped-def]
        half = np.empty((6, 6, channels), np.float32)
        for t in range(tiles.shape[2]):
            y, left = _tile_corner(t, (padded.shape[1] - 2 * dilation) // TILE, dilation)
            for j in range(6):
                x = left + j * dilation
                for c in range(channels):
                    half[0, j, c], half[1, j, c], half[2, j, c], half[3, j, c], half[4, j, c], half[5, j, c] = (
                        _b_transposed(
                            padded[y, x, c],
                            padded[y + 1, x, c],
                            padded[y + 2, x, c],
                            padded[y + 3, x, c],
                            padded[y + 4, x, c],
                            padded[y + 5, x, c],
                        )
                    )
            for i in range(6):
                for c in range(channels):
                    k = offset + c
                    (
                        tiles[i, 0, t, k],
                        tiles[i, 1, t, k],
                        tiles[i, 2, t, k],
                        tiles[i, 3, t, k],
                        tiles[i, 4, t, k],
                        tiles[i, 5, t, k],
                    ) = _b_transposed(
                        half[i, 0, c], half[i, 1, c], half[i, 2, c], half[i, 3, c], half[i, 4, c], half[i, 5, c]
                    )

    compiled: Kernel = transform
    return compiled


@functools.cache
def inverse_transform(outputs: int) -> Kernel:
    """The kernel of A^T m A: from products (6, 6, T, N) to `sums` (rows, columns, N)."""

    @kernel("void(float32[:,:,:,::1], int64, float32[:,:,::1])")
    def inverse(products, dilation, sums):  # type: ignore[no-untyped-def]
        half = np.empty((4, 6, outputs), np.float32)
        for t in range(products.shape[2]):
            y, x = _tile_corner(t, sums.shape[1] // TILE, dilation)
            for j in range(6):
                for n in range(outputs):
                    half[0, j, n], half[1, j, n], half[2, j, n], half[3, j, n] = _a_transposed(
                        products[0, j, t, n],
                        products[1, j, t, n],
                        products[2, j, t, n],
                        products[3, j, t, n],
                        products[4, j, t, n],
                        products[5, j, t, n],
                    )
            for i in range(4):
                for n in range(outputs):
                    (
                        sums[y + i, x, n],
                        sums[y + i, x + dilation, n],
                        sums[y + i, x + 2 * dilation, n],
                        sums[y + i, x + 3 * dilation, n],
                    ) = _a_transposed(
                        half[i, 0, n], half[i, 1, n], half[i, 2, n], half[i, 3, n], half[i, 4, n], half[i, 5, n]
                    )

    compiled: Kernel = inverse
    return compiled


class BFloat16Convolution:
    """The sums of WinogradConvolution, as direct convolutions in bfloat16 and one band."""

    def __init__(self, weight: Tensor, channels: Sequence[int], size: int, dilation: int) -> None:
        self._weight = weight.bfloat16().contiguous(memory_format=torch.channels_last)
        self._dilation = dilation
        self._image = torch.zeros(1, size, size, sum(channels), dtype=torch.bfloat16).permute(0, 3, 1, 2)
        self._parts = torch.split(self._image, list(channels), dim=1)

    def bands(self, images: Sequence[Float32Array]) -> Iterator[tuple[range, Float32Array]]:
        """All rows, and their sums (M, M, N) as bits in uint16."""
        for part, image in zip(self._parts, images, strict=True):
            part.copy_(as_tensor(image))
        sums = conv2d(self._image, self._weight, padding=self._dilation, dilation=self._dilation)
        cells = as_cells(sums.view(torch.uint16))
        yield range(len(cells)), cells


class OneOutputConvolution:
    """A convolution with one output: a matrix product for all its taps, then the sum of their shifted maps."""

    def __init__(self, convolution: nn.Conv2d, size: int) -> None:
        (weight,) = convolution.weight.detach()
        self._taps = weight.flatten(1).T.contiguous()
        self._bias = float(convolution.bias.detach())  # type: ignore[union-attr]
        self._maps = torch.zeros(len(self._taps), size * size)
        self._as_grid = self._maps.view(*weight.shape[1:], size, size).numpy()

    def __call__(self, features: Tensor) -> Tensor:
        """(1, C, M, M) -> (1, M, M)."""
        torch.mm(self._taps, features[0].flatten(1), out=self._maps)
        sums = torch.empty(features.shape[2:])
        add_shifted(self._as_grid, self._bias, sums.numpy())
        return sums[None]


@kernel("void(float32[:,:,:,::1], float32, float32[:,::1])")
def add_shifted(maps, bias, out):  # type: ignore[no-untyped-def]
    """out[r, x] = bias + sum over i, j = 0..2k of maps[i, j, r + i - k, x + j - k], zero outside the grid."""
    size, side = out.shape[0], maps.shape[0]
    reach = side // 2
    for r in range(size):
        for x in range(size):  # single numbers: slices take numba ten times as long to compile
            out[r, x] = bias
        for i in range(max(0, reach - r), min(side, size + reach - r)):
            for j in range(side):
                aside = j - reach
                for x in range(max(0, -aside), min(size, size - aside)):
                    out[r, x] += maps[i, j, r + i - reach, x + aside]
