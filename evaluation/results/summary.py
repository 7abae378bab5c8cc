"""summary.json: the results of a run, with scores, intervals and paired differences."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

from pydantic import Field, model_validator

from gridtrack.evaluation.results.files import read_model, write_model
from gridtrack.evaluation.results.recording import LONGEST_S, RecordingSummary, refuse_unordered
from gridtrack.evaluation.results.trial_summary import PooledSummary, ScopeSummary, TrialSummary, curves_of
from gridtrack.evaluation.results.values import Curve, Line, Number, ResultModel
from gridtrack.trackers.contract import Role

SUMMARY_SCHEMA: Final = 2
SUMMARY_FILE = "summary.json"
MAX_SUMMARY_BYTES = 256 << 20
ALL_RECORDINGS = "all recordings"
"""The name of all recordings of a run together; no recording may have it."""
ORACLE = "oracle"
"""Label of the ceiling, which the referee computes where there is truth; no tracker may have it."""


class TrackerSummary(ResultModel):
    """One row of the comparison: a tracker with its options, on every recording."""

    tracker: str
    role: Role = "tracker"
    """A floor is a row that every tracker must beat."""
    options: dict[str, Any] = Field(default_factory=dict)
    points: str = ""
    """The returns in each frame: `centres` of occupied cells, or `raw`."""
    recordings: dict[str, TrialSummary]
    pooled: PooledSummary | None = None
    """Over all recordings; null for a single one, or where rate, horizon or grid differ."""

    @property
    def ceiling(self) -> bool:
        """Whether it is the score of an ideal tracker: shown, and never ranked."""
        return self.tracker == ORACLE

    @property
    def floor(self) -> bool:
        """Whether it is one of the rows that every tracker must beat."""
        return self.role == "floor"


class HeadlineTest(ResultModel):
    """A tracker's F1 less the reference's at one horizon, with its test; beside it the other scores' differences.

    Only F1 is corrected and has a verdict. The p-values of log loss, PR-AUC and the scores that forgive a few cells
    are uncorrected. The latter are null in a run of before, and where one of the two has none.
    """

    stratum: str
    horizon_s: float
    step: int = 0
    f1: Number = None
    f1_low: Number = None
    f1_high: Number = None
    f1_p: Number = None
    p_holm: Number = None
    """Corrected over all headline tests of the run (Holm 1979)."""
    verdict: str
    """`better`, `worse`, `no difference shown` or `not tested`, of F1."""
    nll: Number = None
    nll_low: Number = None
    nll_high: Number = None
    nll_p: Number = None
    pr_auc: Number = None
    pr_auc_low: Number = None
    pr_auc_high: Number = None
    pr_auc_p: Number = None
    fss_1: Number = None
    fss_1_low: Number = None
    fss_1_high: Number = None
    fss_1_p: Number = None
    fss_3: Number = None
    fss_3_low: Number = None
    fss_3_high: Number = None
    fss_3_p: Number = None
    fss_5: Number = None
    fss_5_low: Number = None
    fss_5_high: Number = None
    fss_5_p: Number = None
    fss_9: Number = None
    fss_9_low: Number = None
    fss_9_high: Number = None
    fss_9_p: Number = None
    soft_iou: Number = None
    soft_iou_low: Number = None
    soft_iou_high: Number = None
    soft_iou_p: Number = None
    beam_error: Number = None
    beam_error_low: Number = None
    beam_error_high: Number = None
    beam_error_p: Number = None


class Difference(ResultModel):
    """One tracker against the reference on a recording, or on all: what every such comparison has."""

    recordings: str
    """The name of the recording, or ALL_RECORDINGS."""
    tracker: str
    reference: str
    units: int = 0
    """Statistical units: whole recordings, or blocks of time."""
    frames: int = 0
    """Scored frames that both have."""
    interval: Line = ""
    """Why there is no interval or no comparison; empty where there is."""


class DifferenceCurves(ResultModel):
    """F1 of a tracker less that of the reference in one stratum, per step."""

    f1: Curve
    f1_low: Curve
    f1_high: Curve
    f1_p: Curve


class TrackerDifference(Difference):
    """Paired differences of F1."""

    strata: dict[str, DifferenceCurves] = Field(default_factory=dict)
    headline: tuple[HeadlineTest, ...] = Field(default=(), max_length=100)


class ClassLossCurves(ResultModel):
    """Log loss of the classes of a scan less the reference's, per step, nats."""

    nll_per_scan: Curve
    nll_per_scan_low: Curve
    nll_per_scan_high: Curve
    nll_per_scan_p: Curve


class ClassDifference(Difference):
    """Paired differences of class probabilities; the reference is the one for classes."""

    kinds: dict[str, ClassLossCurves] = Field(default_factory=dict)
    """By visibility."""


class ScoreDifference(ResultModel):
    """A score less the reference's, per step, with 95 % confidence interval and p-value."""

    value: Curve
    low: Curve
    high: Curve
    p: Curve


class OccludedDifference(Difference):
    """Paired differences on occluded cells."""

    scores: dict[str, ScoreDifference] = Field(default_factory=dict)
    """`f1` at the threshold chosen with the truth, `f1_at_visible`, `f1_at_half`, and `nll`."""


class TrainingsScore(ResultModel):
    """F1 of the trainings of a tracker in one stratum at one horizon, and their mean less that of the reference's."""

    stratum: str
    horizon_s: float
    step: int = 0
    f1: tuple[Number, ...]
    """Of each training."""
    f1_mean: Number = None
    f1_spread: Number = None
    """Standard deviation between trainings; null with one."""
    difference: Number = None
    difference_low: Number = None
    difference_high: Number = None
    difference_p: Number = None
    p_holm: Number = None
    """Corrected over all differences between trackers by their trainings (Holm 1979)."""
    verdict: str = ""
    """As of HeadlineTest; empty for the reference."""


class TrackerTrainings(ResultModel):
    """The rows of one tracker that differ in their weights alone, on a recording, or on all.

    The interval of a difference includes the variation between units and that between trainings.
    """

    recordings: str
    tracker: str
    labels: tuple[str, ...]
    """One row for each training; the first names the tracker."""
    reference: str
    """The first label of the reference."""
    units: int = 0
    interval: Line = ""
    """Why there is no interval; empty where there is."""
    scores: tuple[TrainingsScore, ...] = Field(default=(), max_length=100)


class PairTest(ResultModel):
    """One row less another in a score, with the 95 % interval and the test of their difference."""

    tracker: str
    other: str
    difference: Number = None
    low: Number = None
    high: Number = None
    p: Number = None
    p_holm: Number = None
    """Corrected over the pairs of the family (Holm 1979)."""
    verdict: str
    """As of HeadlineTest: `better` where `tracker` is better, also in a score whose lower values are."""


class PairFamily(ResultModel):
    """All pairs of comparable rows in one score, stratum and horizon, on a recording or on all: one family of tests."""

    recordings: str
    score: str
    stratum: str
    horizon_s: float
    step: int
    units: int
    pairs: tuple[PairTest, ...]


class RunSummary(ResultModel):
    """The results of a run."""

    schema_version: Literal[2] = Field(default=SUMMARY_SCHEMA, alias="schema")
    interrupted: bool = False
    notices: tuple[Line, ...] = ()
    """What to know before a comparison, a line for each."""
    recordings: dict[str, RecordingSummary] = Field(min_length=1)
    pooled_horizons_s: tuple[Annotated[float, Field(ge=0.0, le=LONGEST_S)], ...] = ()
    """Of the scores of all recordings together; empty where there are none, and in runs of before, in which these are
    the horizons of each recording."""
    trackers: dict[str, TrackerSummary]
    """By label."""
    reference: str | None = None
    """Label of the row that the others are compared with."""
    differences: tuple[TrackerDifference, ...] = ()
    class_differences: tuple[ClassDifference, ...] = ()
    occluded_differences: tuple[OccludedDifference, ...] = ()
    pairs: tuple[PairFamily, ...] = ()
    """Empty with too few statistical units, and in a run of before."""
    trainings: tuple[TrackerTrainings, ...] = ()
    """Where a tracker has several trainings: every tracker, with the spread between its trainings."""

    @property
    def has_pooled(self) -> bool:
        """Whether every row has scores over several recordings together."""
        pooled = bool(self.trackers) and all(row.pooled is not None for row in self.trackers.values())
        return pooled and len(self.recordings) > 1 and ALL_RECORDINGS not in self.recordings

    @model_validator(mode="after")
    def _curves_reach_every_horizon(self) -> Self:
        refuse_unordered(self.pooled_horizons_s)
        steps = {name: len(recording.horizons_s) for name, recording in self.recordings.items()}
        if self.has_pooled:
            steps[ALL_RECORDINGS] = len(self.pooled_horizons_s) or next(iter(steps.values()))
        for label, row in self.trackers.items():
            for name in row.recordings.keys() - self.recordings.keys():
                raise ValueError(f"tracker {label} has scores on {name}, which is not among the recordings")
            pooled = [(ALL_RECORDINGS, row.pooled)] if self.has_pooled and row.pooled else []
            for name, scope in [*pooled, *row.recordings.items()]:
                _refuse_other_lengths(f"{label} on {name}", scope, steps[name])
        compared: list[tuple[Difference, Mapping[str, ResultModel]]] = [
            *((one, one.strata) for one in self.differences),
            *((one, one.kinds) for one in self.class_differences),
            *((one, one.scores) for one in self.occluded_differences),
        ]
        for one, parts in compared:
            expected = steps.get(one.recordings, 0)
            if any(len(curve) != expected for _, curve in curves_of(parts)):
                raise ValueError(f"{one.tracker} on {one.recordings}: differences not of {expected} steps")
        return self

    def write(self, folder: Path) -> None:
        """Write it into the run's folder. Raises OSError."""
        write_model(folder / SUMMARY_FILE, self)


def _refuse_other_lengths(where: str, scope: ScopeSummary, steps: int) -> None:
    for name, curve in scope.curves():
        if len(curve) != steps:
            raise ValueError(f"{where}, {name}: {len(curve)} steps, expected {steps}")


def read_summary(folder: Path) -> RunSummary:
    """The summary in a run's folder. Raises FileNotFoundError where it has none, and RunError."""
    remedy = "read it with the version that wrote it, or compare again"
    return read_model(folder / SUMMARY_FILE, RunSummary, SUMMARY_SCHEMA, MAX_SUMMARY_BYTES, remedy)
