"""Arrays of different lengths one after the other: the returns of clusters, the boundaries of tracks; none is empty."""

from __future__ import annotations

from collections.abc import Sequence, Sized
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray


def bounds_of(parts: Sequence[Sized]) -> NDArray[np.int64]:
    """The rows (G+1,) of all G parts together at which each begins, and at which the last one ends."""
    return np.cumsum([0, *map(len, parts)])


def spans_of(points: NDArray[np.float64], bounds: NDArray[np.int64]) -> NDArray[np.float64]:
    """The longer side of the bounding box (G,) of each part of `points` (N, 2)."""
    first = bounds[:-1]
    return np.asarray((np.maximum.reduceat(points, first) - np.minimum.reduceat(points, first)).max(axis=1))


def centres_of(points: NDArray[np.float64], bounds: NDArray[np.int64]) -> NDArray[np.float64]:
    """The mean (G, 2) of each part of `points` (N, 2)."""
    return np.asarray(np.add.reduceat(points, bounds[:-1]) / np.diff(bounds)[:, None])


def split(rows: NDArray[Any], parts: Sequence[Sized]) -> list[NDArray[Any]]:
    """The rows (N, ...) of all parts together, part by part."""
    return [rows[first:last] for first, last in pairwise(bounds_of(parts).tolist())]
