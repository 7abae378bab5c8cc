"""How the pose of a scan was found, and how well the scan fits there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

MatchOutcome = Literal["start", "matched", "partial", "few-returns", "few-inliers", "far"]
MATCH_OUTCOMES: tuple[str, ...] = get_args(MatchOutcome)


@dataclass(frozen=True, slots=True)
class PoseQuality:
    """The match of a scan with the scans before it.

    `outcome` is `start` for the first scan, `matched`, or `partial` where a direction is open, in which the pose is the
    prior's: nothing constrains it, as along a corridor, or one compact cluster alone, which may move. A scan with
    `few-returns`, with `few-inliers`, or whose match is `far` from the prior has the prior's pose. `inlier_share` is
    the share of its returns on the map, `residual_m` their median distance from the map's walls; both are 0 where the
    scan was not matched.
    """

    outcome: MatchOutcome
    inlier_share: float = 0.0
    residual_m: float = 0.0

    @property
    def failed(self) -> bool:
        """Whether the pose is the prior's."""
        return self.outcome in ("few-returns", "few-inliers", "far")

    @property
    def fell_back(self) -> bool:
        """Whether all of the pose or a part of it is the prior's."""
        return self.failed or self.outcome == "partial"
