"""Flow error: forecast velocities against the true ones, on the cells that are occupied when the step has come.

End-point error as of Occupancy Flow Fields (Mahjourian et al., IEEE Robotics and Automation Letters 7, 2022), as a
velocity in place of a displacement.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gridtrack.evaluation.referee.referee import ScoredForecast
from gridtrack.evaluation.referee.strata import OCCLUDED
from gridtrack.evaluation.referee.targets import cell_regions, members
from gridtrack.evaluation.scores.definition import Floats, Output, Ratio, ScoreDefinition, Sums, TrialFacts

FLOW_STRATA = ("dynamic", "in-motion", OCCLUDED)
"""The strata that have flow errors, of recordings with ground truth."""
_MEMBERS = members(FLOW_STRATA)


class _Begun:
    """Whether a forecast of the trial had velocities: cells count from the first one on."""

    def __init__(self, facts: TrialFacts) -> None:
        self.begun = False


def _count(forecast: ScoredForecast, facts: TrialFacts, memory: _Begun) -> Floats | None:
    """Sums (S, K, 4) over occupied cells with a known true velocity.

    Cells, cells with a forecast velocity, and over these the distance from the true velocity, and the true speed, m/s.
    The velocity is as of the contract: (steps+1, 2, M, M), or (2, M, M), which is step 0 alone.
    """
    velocity, ages = forecast.forecast.velocity, forecast.ages
    memory.begun = memory.begun or velocity is not None
    if not memory.begun:
        return None
    if velocity is None:
        velocity = np.zeros((0, 2, *ages.shape))
    planes = velocity[None] if velocity.ndim == 3 else velocity
    sums = np.zeros((len(forecast.targets), len(FLOW_STRATA), 4))
    for n, target in enumerate(forecast.targets):
        flow = target.flow()
        member = _MEMBERS[:, cell_regions(target, forecast.region_maps, ages).ravel()[flow.cells]]
        sums[n, :, 0] = member.sum(axis=1)
        if n < len(planes):
            own = planes[n].reshape(2, -1)[:, flow.cells].T.astype(np.float64)
            given = np.isfinite(own).all(axis=1)
            member = member[:, given]
            sums[n, :, 1] = member.sum(axis=1)
            sums[n, :, 2] = member @ np.linalg.norm(own[given] - flow.velocity[given], axis=1)
            sums[n, :, 3] = member @ np.linalg.norm(flow.velocity[given], axis=1)
    return sums


def _value(sums: Sums) -> Mapping[str, Ratio]:
    given = sums["given"]
    return {
        "mean": Ratio(sums["error"], given),
        "true_speed": Ratio(sums["speed"], given),
        "coverage": Ratio(given, sums["cells"], counted=True),
    }


FLOW_ERROR = ScoreDefinition(
    name="flow_error",
    title="Flow error",
    position=90,
    outputs=(
        Output("mean", "Flow error", unit="m/s", better="lower", scale="log"),
        Output("true_speed", "True speed where flow is given", unit="m/s", scale="log"),
        Output("coverage", "Cells with flow", scale="odds"),
    ),
    about="Mean distance, m/s, of the forecast velocity of a cell from the true velocity of the body that occupies it."
    " The true speed of the same cells is the error of a forecast in which nothing moves. A forecast that gives"
    " velocities only where it is sure has a low error and a low coverage: compare rows of alike coverage only."
    " Mahjourian et al., 2022.",
    strata=lambda facts: FLOW_STRATA if facts.has_truth else (),
    parts=lambda facts: ("cells", "given", "error", "speed"),
    count=_count,
    value=_value,
    new_memory=_Begun,
    needed="velocities of the forecast, and ground truth",
)
