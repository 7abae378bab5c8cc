"""summary.json: the results of a run, with estimates of every score, paired differences and tests."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

from pydantic import Field, model_validator

from gridtrack.common.files import write_text
from gridtrack.common.notices import Line, Notice
from gridtrack.evaluation.referee.splits import ORACLE
from gridtrack.evaluation.runs.passes import Deadline, Latency, Robustness
from gridtrack.evaluation.runs.result_files import Curve, Curves, Number, ResultModel, read_model
from gridtrack.evaluation.runs.run_record import LONGEST_S, RecordingSummary, refuse_unordered
from gridtrack.evaluation.runs.trial_record import Times, all_scored
from gridtrack.evaluation.scores.definition import LEADING_HORIZONS_S, Output, ScoreDefinition
from gridtrack.evaluation.scores.registry import output_named
from gridtrack.trackers.contract import ComparedPart, Role

SUMMARY_SCHEMA: Final = 3
SUMMARY_FILE = "summary.json"
MAX_SUMMARY_BYTES = 256 << 20
ALL_RECORDINGS = "all recordings"
"""The name of all recordings of a run together; no recording may have it."""


class OutputDescription(ResultModel):
    """An output of a score, as `scores.definition.Output`."""

    name: str
    title: str
    unit: str = ""
    better: Literal["", "higher", "lower"] = ""
    tested: bool = False
    decimals: int = Field(3, ge=0, le=6)
    saying: Line = ""
    of_trial: bool = False
    beside: bool = False

    @property
    def direction(self) -> int:
        """1 if higher values are better, -1 if lower ones are, else 0."""
        return {"higher": 1, "lower": -1, "": 0}[self.better]

    @property
    def heading(self) -> str:
        """The title, with the unit."""
        return f"{self.title}, {self.unit}" if self.unit else self.title

    @classmethod
    def of(cls, output: Output) -> Self:
        """The description of an output."""
        return cls(**{name: getattr(output, name) for name in cls.model_fields})


class ScoreDescription(ResultModel):
    """A score, so that a reader of the summary needs no list of scores of its own."""

    name: str
    title: str
    about: str = ""
    compared_with: ComparedPart = "occupancy"
    """Whether the row that others are compared with is the reference for occupancy or for classes."""
    thresholded: bool
    """Whether its values depend on the threshold that was chosen."""
    stratum: str = "in-motion"
    """The stratum in which it leads."""
    horizons_s: Annotated[tuple[Annotated[float, Field(gt=0.0, le=LONGEST_S)], ...], Field(max_length=10)] = (
        LEADING_HORIZONS_S
    )
    """The horizons at which it leads, seconds."""
    counted: str = "cells"
    """The noun of what it counts in a stratum."""
    outputs: Annotated[tuple[OutputDescription, ...], Field(min_length=1, max_length=100)]
    """The first one leads."""

    @property
    def lead(self) -> OutputDescription:
        """The output that stands for the score."""
        return self.outputs[0]

    @classmethod
    def of(cls, score: ScoreDefinition) -> Self:
        """The description of a score."""
        same = {name: getattr(score, name) for name in cls.model_fields if name not in ("counted", "outputs")}
        counted = score.events.name if score.events else "cells"
        return cls(**same, counted=counted, outputs=tuple(map(OutputDescription.of, score.outputs)))


class Estimate(ResultModel):
    """A value at each step with its 95 % confidence interval; of a difference also the p-value of none."""

    value: Curve
    low: Curve | None = None
    high: Curve | None = None
    p: Curve | None = None

    def at(self, step: int) -> PointEstimate:
        """The estimate at one step."""
        value, low, high, p = (None if own is None else own[step] for own in (self.value, self.low, self.high, self.p))
        return PointEstimate(value=value, low=low, high=high, p=p)

    def curves(self) -> Iterator[Curve]:
        """Its curves."""
        return (curve for curve in (self.value, self.low, self.high, self.p) if curve is not None)


class PointEstimate(ResultModel):
    """A value with its 95 % confidence interval; of a difference also the p-value of none."""

    value: Number = None
    low: Number = None
    high: Number = None
    p: Number = None

    @property
    def interval(self) -> tuple[float, float] | None:
        """The interval; None if there is none."""
        return None if self.low is None or self.high is None else (self.low, self.high)


Estimates = dict[str, dict[str, Estimate]]
"""By score and output."""
NO_ESTIMATE = PointEstimate()


class ScopeSummary(ResultModel):
    """Scores of one tracker on one recording, or on all of them pooled."""

    outcome: str
    """That of the record; of pooled recordings `ok` or `partial`."""
    reason: Line = ""
    card: str = ""
    """Kind of the weights: `site` or `general`; "general, site" if recordings differ."""
    leak: Line = ""
    """Scored frames, and frames for thresholds, that its weights learned from: not ranked."""
    frames_scored: int = 0
    frames_expected: int = 0
    frames_missing: int = 0
    """Frames without a recorded forecast: not scored."""
    made_by: Line = ""
    """How recorded forecasts were made, by their file."""
    threshold_chosen_on: str = ""
    """The validation stretch; empty without one, or if recordings differ in it."""
    thresholds: dict[str, Curve] = Field(default_factory=dict)
    """By stratum; null if recordings differ."""
    strata: dict[str, Estimates] = Field(default_factory=dict)
    """By stratum, score and output; empty if nothing was scored."""
    interval: Line = ""
    """Why there are no intervals; empty if there are."""
    best_floor: Line = ""
    """Label of the floor with the best headline score; empty if not known."""
    below_floor: bool = False
    """Whether the headline score of a tracker is worse than the best floor's."""
    memory: Line = ""
    """A sign that the tracker remembers the recording from an earlier pass; empty if there is none."""

    @property
    def complete(self) -> bool:
        """Whether every forecast was scored."""
        return self.outcome == "ok" and all_scored(self.frames_scored, self.frames_missing, self.frames_expected)

    @property
    def ranked(self) -> bool:
        """Whether it is complete, with weights that learned from no scored frame."""
        return self.complete and not self.leak

    def estimate(self, stratum: str, score: str, output: str) -> Estimate | None:
        """An estimate; None if there is none."""
        return self.strata.get(stratum, {}).get(score, {}).get(output)

    def at(self, stratum: str, score: str, output: str, step: int) -> PointEstimate:
        """An estimate at one step; of None if it is not known."""
        found = self.estimate(stratum, score, output)
        return NO_ESTIMATE if found is None else found.at(step)

    def curves(self) -> Iterator[tuple[str, Curve]]:
        """Every curve, with its stratum."""
        yield from self.thresholds.items()
        yield from curves_of(self.strata)


class TrialSummary(ScopeSummary):
    """One tracker on one recording."""

    weights_sha256: str = ""
    recoveries: int = 0
    """The tracker's word, not checked."""
    latency_ms: Latency | None = None
    deadline: Deadline | None = None
    robustness: Robustness | None = None
    """With the undegraded scores as strength 0."""
    times: Times = Times()
    peak_rss_mb: Number = None

    def leading(self, outputs: Mapping[str, str]) -> dict[str, Curves]:
        """The values of one of the `outputs` of each score, by score and stratum."""
        return {
            score: {own: found.value for own in self.strata if (found := self.estimate(own, score, output))}
            for score, output in outputs.items()
        }

    def curves(self) -> Iterator[tuple[str, Curve]]:
        """Every curve, those under other conditions included."""
        yield from super().curves()
        for at in self.deadline.rates if self.deadline else ():
            yield from _all_of(at.scores)
        for points in self.robustness.kinds.values() if self.robustness else ():
            for point in points:
                yield from _all_of(point.scores)


class PooledSummary(ScopeSummary):
    """One tracker on all recordings that it completed, together."""

    recordings_complete: int = 0
    recordings_expected: int = 0


class TrackerSummary(ResultModel):
    """One row of the comparison: a tracker with its options, on every recording."""

    tracker: str
    role: Role = "tracker"
    """The tracker's word, not checked: a floor is a row that every tracker must beat."""
    options: dict[str, Any] = Field(default_factory=dict)
    points: str = ""
    """The returns in each frame: `centres` of occupied cells, or `raw`."""
    recordings: dict[str, TrialSummary]
    pooled: PooledSummary | None = None
    """Over all recordings; null for a single one, or if rate, horizon or grid differ."""

    @property
    def ceiling(self) -> bool:
        """Whether it is the score of an ideal tracker: shown, and never ranked."""
        return self.tracker == ORACLE

    @property
    def floor(self) -> bool:
        """Whether it is one of the rows that every tracker must beat."""
        return self.role == "floor"


class HeadlineTest(ResultModel):
    """The verdict on a tracker against the reference in the headline score, in one stratum at one horizon."""

    stratum: str
    horizon_s: float
    step: int
    p_holm: Number = None
    """Corrected over all headline tests of the run (Holm 1979)."""
    verdict: str
    """`better`, `worse`, `no difference shown` or `not tested`."""


class TrackerDifference(ResultModel):
    """One tracker less the reference on a recording, or on all: paired differences of every tested score."""

    recordings: str
    """The name of the recording, or ALL_RECORDINGS."""
    tracker: str
    reference: str
    units: int = 0
    """Statistical units: whole recordings, or blocks of time."""
    frames: int = 0
    """Scored frames that both have."""
    interval: Line = ""
    """Why there is no interval or no comparison; empty if there is."""
    strata: dict[str, Estimates] = Field(default_factory=dict)
    """By stratum, score and output."""
    tests: tuple[HeadlineTest, ...] = Field(default=(), max_length=100)
    """Of the headline score; empty for the differences of class scores."""

    def at(self, stratum: str, score: str, output: str, step: int) -> PointEstimate:
        """A difference at one step; of None if it is not known."""
        found = self.strata.get(stratum, {}).get(score, {}).get(output)
        return NO_ESTIMATE if found is None else found.at(step)


class TrainingsScore(ResultModel):
    """The headline score of the trainings of a tracker in one stratum at one horizon."""

    stratum: str
    horizon_s: float
    step: int
    values: tuple[Number, ...]
    """Of each training."""
    mean: Number = None
    spread: Number = None
    """Standard deviation between trainings; null with one."""
    difference: PointEstimate = NO_ESTIMATE
    """Of the mean less the mean of the reference's trainings."""
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
    """Why there is no interval; empty if there is."""
    scores: tuple[TrainingsScore, ...] = Field(default=(), max_length=100)


class PairTest(ResultModel):
    """One row less another in a score, with the 95 % interval and the test of their difference."""

    tracker: str
    other: str
    difference: PointEstimate
    p_holm: Number = None
    """Corrected over the pairs of the family (Holm 1979)."""
    verdict: str
    """As in HeadlineTest: `better` if `tracker` is better, also if lower values of the score are better."""


class PairFamily(ResultModel):
    """All pairs of comparable rows in one score, stratum and horizon, on a recording or on all: one family of tests."""

    recordings: str
    score: str
    output: str
    stratum: str
    horizon_s: float
    step: int
    units: int
    pairs: tuple[PairTest, ...]


class RunSummary(ResultModel):
    """The results of a run."""

    schema_version: Literal[3] = Field(default=SUMMARY_SCHEMA, alias="schema")
    interrupted: bool = False
    notices: tuple[Notice, ...] = ()
    """To know before a comparison."""
    scores: Annotated[tuple[ScoreDescription, ...], Field(max_length=100)] = ()
    """The scores of the run, in the order in which they are listed."""
    headline: str = "f1.f1"
    """SCORE.OUTPUT of the headline score."""
    recordings: dict[str, RecordingSummary] = Field(min_length=1)
    pooled_horizons_s: tuple[Annotated[float, Field(ge=0.0, le=LONGEST_S)], ...] = ()
    """Of the scores of all recordings together; empty if there are none."""
    trackers: dict[str, TrackerSummary]
    """By label."""
    reference: str | None = None
    """Label of the row that the others are compared with."""
    differences: tuple[TrackerDifference, ...] = ()
    pairs: tuple[PairFamily, ...] = ()
    """Empty with too few statistical units."""
    false_differences: dict[str, Annotated[float, Field(ge=0.0, le=1.0)]] = Field(default_factory=dict)
    """How often at least one family of `pairs` has a difference between equal trackers, by their recordings."""
    trainings: tuple[TrackerTrainings, ...] = ()
    """If a tracker has several trainings: every tracker, with the spread between its trainings."""

    @property
    def has_pooled(self) -> bool:
        """Whether every row has scores over several recordings together."""
        pooled = bool(self.trackers) and all(row.pooled is not None for row in self.trackers.values())
        return pooled and len(self.recordings) > 1 and ALL_RECORDINGS not in self.recordings

    @property
    def outputs(self) -> list[tuple[ScoreDescription, OutputDescription]]:
        """Every output of every score, in their order."""
        return [(score, output) for score in self.scores for output in score.outputs]

    def find(self, text: str) -> tuple[ScoreDescription, OutputDescription]:
        """The score and output of `f1` (the leading output) or `f1.recall`. Raises ConfigurationError."""
        name, output = output_named(text, {one.name: [own.name for own in one.outputs] for one in self.scores})
        return next((one, own) for one, own in self.outputs if (one.name, own.name) == (name, output))

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
                _refuse_other_lengths(f"{label} on {name}", scope.curves(), steps[name])
        for one in self.differences:
            where = f"{one.tracker} on {one.recordings}: differences"
            _refuse_other_lengths(where, curves_of(one.strata), steps.get(one.recordings, 0))
        return self

    def write(self, folder: Path) -> None:
        """Write it into the run's folder, without indentation, which would be over half of it. Raises OSError."""
        write_text(folder / SUMMARY_FILE, self.model_dump_json(by_alias=True) + "\n")


def curves_of(strata: Mapping[str, Estimates]) -> Iterator[tuple[str, Curve]]:
    """Every curve of these estimates, with its stratum."""
    for stratum, scores in strata.items():
        for outputs in scores.values():
            for estimate in outputs.values():
                yield from ((stratum, curve) for curve in estimate.curves())


def _all_of(scores: Mapping[str, Curves]) -> Iterator[tuple[str, Curve]]:
    for curves in scores.values():
        yield from curves.items()


def _refuse_other_lengths(where: str, curves: Iterator[tuple[str, Sequence[float | None]]], steps: int) -> None:
    for name, curve in curves:
        if len(curve) != steps:
            raise ValueError(f"{where}, {name}: {len(curve)} steps, expected {steps}")


def read_summary(folder: Path) -> RunSummary:
    """The summary in a run's folder. Raises FileNotFoundError if it has none, and RunError."""
    remedy = "read it with gridtrack 0.2, which wrote it, or compare again"
    return read_model(folder / SUMMARY_FILE, RunSummary, SUMMARY_SCHEMA, MAX_SUMMARY_BYTES, remedy)
