"""Flow errors: forecast velocities against the true ones, on the cells that are occupied when the step has come.

End-point error as of Occupancy Flow Fields (Mahjourian et al., IEEE Robotics and Automation Letters 7, 2022), as a
velocity in place of a displacement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gridtrack.evaluation.scoring.neighbourhoods import NO_REGION, cell_regions
from gridtrack.evaluation.scoring.strata import OCCLUDED, REGIONS, STRATA_WITH_TRUTH, SUMS_OF_REGIONS, RegionMaps
from gridtrack.evaluation.scoring.target import Target

FLOW_STRATA = ("dynamic", "in-motion", OCCLUDED)
"""The strata that have flow errors, of recordings with ground truth."""
_MEMBER_OF = np.zeros((len(FLOW_STRATA), REGIONS + 1), np.bool_)
_MEMBER_OF[:, :NO_REGION] = SUMS_OF_REGIONS[[STRATA_WITH_TRUTH.index(name) for name in FLOW_STRATA]]


@dataclass(frozen=True, slots=True)
class FlowErrors:
    """Sums of one forecast, per step S = steps+1 and stratum K of FLOW_STRATA, each (S, K).

    `cells`: occupied cells whose true velocity is known; `given`: those of them that the forecast has a velocity for;
    over these `error`: sum of the distances between forecast and true velocity, m/s, and `speed`: sum of the true
    speeds, m/s.
    """

    cells: NDArray[np.int64]
    given: NDArray[np.int64]
    error: NDArray[np.float64]
    speed: NDArray[np.float64]

    @classmethod
    def none(cls, steps: int) -> FlowErrors:
        """Of no cells."""
        counts, sums = np.zeros((2, steps + 1, len(FLOW_STRATA)), np.int64), np.zeros((2, steps + 1, len(FLOW_STRATA)))
        return cls(*counts, *sums)


def flow_errors(
    velocity: NDArray[np.floating] | None, targets: Sequence[Target], region_maps: RegionMaps, ages: NDArray[np.uint8]
) -> FlowErrors:
    """The errors of the `velocity` of a forecast made at frame t: step n against frame t+n.

    `velocity` as of the contract: (steps+1, 2, M, M), or (2, M, M), which is step 0 alone. `targets`, `region_maps` and
    `ages` as of `counting.count_forecast`.
    """
    sums = FlowErrors.none(len(targets) - 1)
    if velocity is None:
        velocity = np.zeros((0, 2, *ages.shape))
    planes = velocity[None] if velocity.ndim == 3 else velocity
    for n, target in enumerate(targets):
        flow = target.flow()
        member = _MEMBER_OF[:, cell_regions(target, region_maps, ages).ravel()[flow.cells]]
        sums.cells[n] = member.sum(axis=1)
        if n < len(planes):
            own = planes[n].reshape(2, -1)[:, flow.cells].T.astype(np.float64)
            given = np.isfinite(own).all(axis=1)
            member = member[:, given]
            sums.given[n] = member.sum(axis=1)
            sums.error[n] = member @ np.linalg.norm(own[given] - flow.velocity[given], axis=1)
            sums.speed[n] = member @ np.linalg.norm(flow.velocity[given], axis=1)
    return sums
