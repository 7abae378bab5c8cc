"""The array types of the pipeline, and arrays of several parts: concatenated rows with bounds."""

from __future__ import annotations

from collections.abc import Sequence, Sized
from itertools import accumulate, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""Double precision; each function states shape and unit."""


def bounds_of(parts: Sequence[Sized]) -> NDArray[np.int64]:
    """The first row of each of G concatenated parts, and the end of the last one (G+1,)."""
    return np.array([*accumulate(map(len, parts), initial=0)])


def owners_of(bounds: NDArray[np.int64]) -> NDArray[np.int64]:
    """The number of the part of each row (N,)."""
    return np.repeat(np.arange(len(bounds) - 1), np.diff(bounds))


def spans_of(points: NDArray[np.float64], bounds: NDArray[np.int64]) -> NDArray[np.float64]:
    """The longer side of the bounding box (G,) of each part of `points` (N, 2)."""
    first = bounds[:-1]
    return np.asarray((np.maximum.reduceat(points, first) - np.minimum.reduceat(points, first)).max(axis=1))


def means_of(rows: NDArray[Any], bounds: NDArray[np.int64]) -> NDArray[np.float64]:
    """The mean (G, ...) of each part of the rows (N, K)."""
    return np.asarray(np.add.reduceat(rows, bounds[:-1], dtype=np.float64) / np.diff(bounds)[:, None])


def split(rows: NDArray[Any], parts: Sequence[Sized]) -> list[NDArray[Any]]:
    """The concatenated rows (N, ...) of the `parts`, part by part."""
    return [rows[first:last] for first, last in pairwise(accumulate(map(len, parts), initial=0))]
