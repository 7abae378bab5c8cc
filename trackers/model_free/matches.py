"""What is matched, outlines of returns and of boundaries in pairs, and what comes of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gridtrack.common.grid import Mask
from gridtrack.trackers.model_free.arrays import Array
from gridtrack.trackers.model_free.ragged import bounds_of


class Outlines(NamedTuple):
    """G outlines one after the other: their points (N, 2) in metres, how likely each is to be there (N,), and at which
    the outline is cut off (N,). Those of outline g are `bounds` (G+1,) [g] to [g+1].
    """

    points: Array
    weights: Array
    cut: Mask
    bounds: NDArray[np.int64]

    @classmethod
    def of(cls, points: Sequence[Array], weights: Sequence[Array] | None, cut: Sequence[Mask]) -> Outlines:
        """The outlines, from the points (N, 2), weights (N,) and cut-off ends (N,) of each; there is at least one.

        Without weights all points are there.
        """
        bounds = bounds_of(points)
        likely = np.ones(bounds[-1]) if weights is None else np.concatenate(weights)
        return cls(np.concatenate(points), likely, np.concatenate(cut), bounds)


class Match(NamedTuple):
    """A measured pose (3,): x, y, heading; its covariance (3, 3); and the `residual` of the returns.

    The residual is the mean over returns of the squared distance to the boundary in kernel widths, as the mixture sees
    it: 0 where they lie on it, 9 where none does.
    """

    pose: Array
    covariance: Array
    residual: float


class Matches(NamedTuple):
    """Those of P pairs: `poses` (P, 3), `covariances` (P, 3, 3) and `residuals` (P,), each as that of a Match.

    A pair has so many degrees of `freedom` (P,): a pose that shows no heading has two, and keeps the one it began with.
    """

    poses: Array
    covariances: Array
    residuals: Array
    freedom: NDArray[np.int64]

    def of(self, pair: int) -> Match:
        """That of one pair."""
        return Match(self.poses[pair], self.covariances[pair], float(self.residuals[pair]))


class Pairs(NamedTuple):
    """P pairs to match: which boundary and which outline of returns, `numbers` (P, 2), from which `starts` (P, S, 3).

    Each finite start, x, y and heading, is as uncertain as `unsure_m` (P,) in metres. Only what `goes_on` (P,) may go
    on unseen where it is cut off; what `turns` (P,) is of which both show a heading.
    """

    numbers: NDArray[np.int64]
    starts: Array
    unsure_m: Array
    goes_on: Mask
    turns: Mask
