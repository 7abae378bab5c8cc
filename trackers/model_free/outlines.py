"""Inputs and results of scan matching: outlines of returns and boundaries, pairs of them, and matched poses."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import Mask
from gridtrack.trackers.model_free.arrays import Array
from gridtrack.trackers.model_free.ragged import bounds_of


class Outlines(NamedTuple):
    """G concatenated outlines: points (N, 2), metres, their weights (N,), and where each outline is cut off (N,).

    The points of outline g are those from `bounds` (G+1,) [g] to [g+1]; a weight is the probability of a return there.
    """

    points: Array
    weights: Array
    cut: Mask
    bounds: NDArray[np.int64]

    @classmethod
    def of(cls, points: Sequence[Array], weights: Sequence[Array] | None, cut: Sequence[Mask]) -> Outlines:
        """The outlines, at least one, from points (N, 2), weights (N,), by default 1, and cut-off ends (N,) of each."""
        bounds = bounds_of(points)
        all_weights = np.ones(bounds[-1]) if weights is None else np.concatenate(weights)
        return cls(np.concatenate(points), all_weights, np.concatenate(cut), bounds)


class Match(NamedTuple):
    """A measured pose (3,): x, y, heading; its covariance (3, 3); and the `residual` of the returns.

    The residual is -2 times the mean log likelihood of the returns under the mixture, comparable to a squared distance
    in kernel widths: 0 where all lie on the boundary, 9 where none does.
    """

    pose: Array
    covariance: Array
    residual: float


class Matches(NamedTuple):
    """The matches of P pairs: `poses` (P, 3), `covariances` (P, 3, 3) and `residuals` (P,).

    `freedom` (P,): degrees of freedom, 3, or 2 where the heading is not observable and that of the start is kept.
    """

    poses: Array
    covariances: Array
    residuals: Array
    freedom: NDArray[np.int64]

    def of(self, pair: int) -> Match:
        """The match of one pair."""
        return Match(self.poses[pair], self.covariances[pair], float(self.residuals[pair]))


class Pairs(NamedTuple):
    """P pairs to match: `numbers` (P, 2) of the boundary and of the outline of returns, and `starts` (P, S, 3).

    A start is x, y and heading, ignored if not finite; `start_error_m` (P,) is its standard deviation in metres.
    Cut-off ends are considered only in pairs that are `extended` (P,): the hidden continuation of a small body is
    short. The heading is observable in pairs that are `oriented` (P,).
    """

    numbers: NDArray[np.int64]
    starts: Array
    start_error_m: Array
    extended: Mask
    oriented: Mask
