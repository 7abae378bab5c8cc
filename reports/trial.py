"""What summary.json says of one trial, checked as the report wants it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

HIGHEST, MOST_CONDITIONS = 1e6, 20
"""Rates and strengths of degradation beyond this are nonsense; of conditions no more than these are drawn."""


def _number_or_none(value: Any) -> Any:
    """NaN and infinities are what a score is where it is not defined."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


Number = Annotated[float | None, BeforeValidator(_number_or_none)]
Curve = tuple[Number, ...]
"""One score at every step 0..n; None where it is not defined, as in a stratum that was never seen."""


class Read(BaseModel):
    """A part of a file that another program wrote: what the report does not know yet, it leaves alone."""

    model_config = ConfigDict(frozen=True, extra="ignore")


class StratumScores(Read):
    """Scores of one trial on one stratum, each per step."""

    f1: Curve
    f1_low: Curve | None = None
    f1_high: Curve | None = None
    precision: Curve
    recall: Curve
    pr_auc: Curve
    brier: Curve
    brier_reliability: Curve | None = None
    brier_resolution: Curve | None = None
    brier_uncertainty: Curve | None = None
    share_of_oracle: Curve | None = None
    nll: Curve
    ece: Curve
    threshold: Curve
    f1_at_visible: Curve
    f1_at_half: Curve
    interval: str = ""
    """Why there is no interval, where there is none."""


class Quantiles(Read):
    """Medians and tails of a time, milliseconds."""

    p50: Number = None
    p95: Number = None
    p99: Number = None


class Latency(Read):
    """What an update, a forecast, and one step of a forecast take."""

    update: Quantiles = Quantiles()
    predict: Quantiles = Quantiles()
    predict_step: Quantiles = Quantiles()


Curves = dict[str, Curve]
"""A score per stratum."""


class AtRate(Read):
    """What a tracker scored in time, its frames coming at `rate` times their own rate."""

    rate: float = Field(gt=0.0, le=HIGHEST)
    rate_hz: float = Field(gt=0.0, le=HIGHEST)
    frames: int
    missed: int
    f1: Curves


class Deadline(Read):
    """What a tracker is worth in time: what it takes for a frame, the rate it holds, its scores at several."""

    busy_ms: Quantiles = Quantiles()
    highest_rate_hz: float = Field(gt=0.0)
    rates: tuple[AtRate, ...] = Field(min_length=1, max_length=MOST_CONDITIONS)


class AtStrength(Read):
    """What a tracker scored on input degraded to `value`."""

    value: float = Field(ge=0.0, le=HIGHEST)
    f1: Curves


class Robustness(Read):
    """What a tracker scored on degraded input, per kind from none to the strongest."""

    kinds: dict[str, Annotated[tuple[AtStrength, ...], Field(min_length=2, max_length=MOST_CONDITIONS)]] = Field(
        max_length=MOST_CONDITIONS
    )

    @model_validator(mode="after")
    def _values_increase(self) -> Robustness:
        for kind, points in self.kinds.items():
            if any(later.value <= earlier.value for earlier, later in pairwise(points)):
                raise ValueError(f"degradation {kind}: its values do not increase")
        return self


class Recall(Read):
    """How many cells of one class there were at each step, and the share of them that was found."""

    recall: Curve
    cells: tuple[int, ...]


class ClassScores(Read):
    """What cells were taken for, at each step."""

    nll_per_cell: Curve
    nll_per_scan: Curve
    nll_per_scan_low: Curve | None = None
    nll_per_scan_high: Curve | None = None
    interval: str = ""
    """Why the log loss has no interval, where it has none."""
    balanced_accuracy: Curve


class Semantics(Read):
    """What cells were taken for, by kind: visible or occluded."""

    kinds: dict[str, ClassScores]


class Trial(Read):
    """One tracker on one recording."""

    outcome: str
    reason: str = ""
    frames_scored: int = 0
    frames_expected: int = 0
    threshold_chosen_on: str = ""
    strata: dict[str, StratumScores] = Field(default_factory=dict)
    latency_ms: Latency | None = None
    peak_rss_mb: Number = None
    deadline: Deadline | None = None
    robustness: Robustness | None = None
    gap_to_truth: Curve | None = None
    recall_by_class: dict[str, dict[str, Recall]] | None = None
    semantics: Semantics | None = None

    @property
    def curves(self) -> Iterator[tuple[str, Curve]]:
        """Every curve that it has, each with its stratum, under all conditions."""
        for stratum, scores in self.strata.items():
            yield from ((stratum, curve) for _, curve in scores if isinstance(curve, tuple))
        for at in self.deadline.rates if self.deadline else ():
            yield from at.f1.items()
        for points in self.robustness.kinds.values() if self.robustness else ():
            for point in points:
                yield from point.f1.items()
        yield from (("visible less occluded", gap) for gap in (self.gap_to_truth,) if gap is not None)
        for classes in (self.recall_by_class or {}).values():
            for name, found in classes.items():
                yield from ((name, found.recall), (name, found.cells))
        for kind, meant in self.semantics.kinds.items() if self.semantics else ():
            yield from ((kind, curve) for _, curve in meant if isinstance(curve, tuple))

    @property
    def complete(self) -> bool:
        """Whether every frame that was to be scored was scored: only such trials are ranked."""
        return self.outcome == "ok" and 0 < self.frames_scored == self.frames_expected
