"""The scores of one tracker on one recording, or on several pooled, as summary.json holds them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from pydantic import Field

from gridtrack.evaluation.results.passes import Deadline, Latency, Robustness
from gridtrack.evaluation.results.trial_record import Times
from gridtrack.evaluation.results.values import CellCounts, Curve, Line, Number, ResultModel

HIGHER_IS_BETTER = (
    *("f1", "f1_at_visible", "f1_at_half", "f1_label_free", "pr_auc"),
    *("fss_1", "fss_3", "fss_5", "fss_9", "soft_iou", "share_of_oracle", "share_of_oracle_nll"),
)
LOWER_IS_BETTER = (
    *("brier", "brier_reliability", "nll", "ece", "ece_above_1_percent"),
    *("beam_error", "beam_error_median", "flow_error", "energy_score"),
)


def better_direction(score: str) -> int:
    """1 where a higher score is better, -1 where a lower one is, 0 for scores that do not rank."""
    return int(score in HIGHER_IS_BETTER) - int(score in LOWER_IS_BETTER)


class StratumScores(ResultModel):
    """Scores in one stratum, each per step; `_low` and `_high` are the ends of 95 % confidence intervals."""

    f1: Curve
    precision: Curve
    recall: Curve
    pr_auc: Curve
    """Average precision."""
    brier: Curve
    brier_reliability: Curve | None = None
    brier_resolution: Curve | None = None
    brier_uncertainty: Curve | None = None
    nll: Curve
    """Log loss, nats."""
    ece: Curve
    """Expected calibration error."""
    ece_above_1_percent: Curve | None = None
    """The same over the cells with p of at least 10/1024, which the tracker considers possibly occupied."""
    threshold: Curve
    f1_at_visible: Curve
    """F1 at the threshold of all visible cells."""
    f1_at_half: Curve
    """F1 at the threshold 0.5."""
    f1_label_free: Curve | None = None
    """F1 at thresholds chosen without labels, from the tracker's own probabilities so far."""
    f1_low: Curve | None = None
    precision_low: Curve | None = None
    recall_low: Curve | None = None
    brier_low: Curve | None = None
    nll_low: Curve | None = None
    pr_auc_low: Curve | None = None
    f1_high: Curve | None = None
    precision_high: Curve | None = None
    recall_high: Curve | None = None
    brier_high: Curve | None = None
    nll_high: Curve | None = None
    pr_auc_high: Curve | None = None
    fss_1: Curve | None = None
    """Fractions skill score of cells: 1 - sum (p - o)^2 / (sum p^2 + sum o^2); null where a run has none."""
    fss_1_low: Curve | None = None
    fss_1_high: Curve | None = None
    fss_3: Curve | None = None
    """The same of the shares of neighbourhoods of 3 x 3 cells."""
    fss_3_low: Curve | None = None
    fss_3_high: Curve | None = None
    fss_5: Curve | None = None
    fss_5_low: Curve | None = None
    fss_5_high: Curve | None = None
    fss_9: Curve | None = None
    fss_9_low: Curve | None = None
    fss_9_high: Curve | None = None
    soft_iou: Curve | None = None
    """Sum p o / sum (p + o - p o)."""
    soft_iou_low: Curve | None = None
    soft_iou_high: Curve | None = None
    beam_error: Curve | None = None
    """Mean distance, metres, from where beams of the observed frame end to where the forecast expects them to."""
    beam_error_low: Curve | None = None
    beam_error_high: Curve | None = None
    beam_error_median: Curve | None = None
    beam_error_median_low: Curve | None = None
    beam_error_median_high: Curve | None = None
    beam_bias: Curve | None = None
    """Mean of the expected less the measured range, metres: above 0 where what is hit was not forecast."""
    beam_bias_low: Curve | None = None
    beam_bias_high: Curve | None = None
    flow_error: Curve | None = None
    """Mean distance, m/s, of forecast from true velocities, over the occupied cells that have both."""
    flow_error_low: Curve | None = None
    flow_error_high: Curve | None = None
    flow_speed: Curve | None = None
    """Mean true speed of these cells, m/s: the error of the forecast that nothing moves."""
    flow_speed_low: Curve | None = None
    flow_speed_high: Curve | None = None
    flow_coverage: Curve | None = None
    """Share of the occupied cells of true bodies that the forecast has a velocity for."""
    flow_coverage_low: Curve | None = None
    flow_coverage_high: Curve | None = None
    energy_score: Curve | None = None
    """Mean distance of the sampled futures from what came, less half their mean distance from each other."""
    energy_score_low: Curve | None = None
    energy_score_high: Curve | None = None
    energy_spread: Curve | None = None
    """The second of these terms: 0 where the futures are all alike."""
    energy_spread_low: Curve | None = None
    energy_spread_high: Curve | None = None
    interval: Line = ""
    """Why there are no intervals; empty where there are."""
    share_of_oracle: Curve | None = None
    """(F1 - floor) / (oracle - floor), floor the best of the floors at each step; null without an oracle."""
    share_of_oracle_nll: Curve | None = None
    """(floor - log loss) / (floor - oracle), floor the lowest log loss of the floors at each step."""

    def at(self, score: str, step: int) -> float | None:
        """A score by its name at one step; None where it is undefined, or where the run has no such score."""
        curve: Curve | None = getattr(self, score)
        return None if curve is None else curve[step]


class ClassRecall(ResultModel):
    """Cells of one class at each step, and the share of them that was called occupied."""

    recall: Curve
    recall_at_half: Curve
    """At the threshold 0.5."""
    cells: CellCounts


class ConfusionAtStep(ResultModel):
    """Confusion counts (K, K+1) at one step: true by predicted classes; the last: a class not in the recording."""

    step: int
    cells: tuple[tuple[int, ...], ...]


class ClassScores(ResultModel):
    """Scores of class probabilities at each step, of cells of one visibility whose class is known."""

    nll_per_scan: Curve
    """Mean over scans of the mean log loss of their cells, nats."""
    nll_summed_over_scans: Curve
    nll_per_cell: Curve
    balanced_accuracy: Curve
    cells: CellCounts
    scans: CellCounts
    confusion: tuple[ConfusionAtStep, ...] = ()
    nll_per_scan_low: Curve | None = None
    nll_per_scan_high: Curve | None = None
    interval: Line = ""
    """Why there is no interval; empty where there is."""


class SemanticScores(ResultModel):
    """Scores of a tracker's class probabilities, by visibility: `visible` or `occluded`."""

    classes: tuple[str, ...] = ()
    kinds: dict[str, ClassScores]


RecallByClass = dict[str, dict[str, ClassRecall]]
"""By visibility and class."""


class ScopeSummary(ResultModel):
    """Scores of one tracker on one recording, or on all of them pooled."""

    outcome: str
    """That of the record; of pooled recordings `ok` or `partial`."""
    reason: Line = ""
    card: str = ""
    """Whether the weights used are those of the `site` or `general` ones; "general, site" where recordings differ."""
    leak: Line = ""
    """What its weights learned from frames that it is scored on, or thresholds are chosen on: it is not ranked."""
    frames_scored: int = 0
    frames_expected: int = 0
    threshold_chosen_on: str = ""
    """The validation stretch; empty without one, or where recordings differ in it."""
    strata: dict[str, StratumScores] = Field(default_factory=dict)
    """Empty where nothing was scored."""
    recall_by_class: RecallByClass | None = None
    semantics: SemanticScores | None = None
    gap_to_truth: Curve | None = None
    """F1 on visible less F1 on occluded cells; null without truth."""

    @property
    def complete(self) -> bool:
        """Whether every forecast was scored."""
        return self.outcome == "ok" and 0 < self.frames_scored == self.frames_expected

    @property
    def ranked(self) -> bool:
        """Whether it is complete, and its weights learned from no frame that it is scored on."""
        return self.complete and not self.leak

    def curves(self) -> Iterator[tuple[str, tuple[float | None, ...]]]:
        """Every curve, with the stratum, class or visibility that it is of."""
        yield from curves_of(self.strata)
        if self.gap_to_truth is not None:
            yield "visible less occluded", self.gap_to_truth
        for by_class in (self.recall_by_class or {}).values():
            yield from curves_of(by_class)
        if self.semantics is not None:
            yield from curves_of(self.semantics.kinds)


class TrialSummary(ScopeSummary):
    """One tracker on one recording."""

    weights_sha256: str = ""
    recoveries: int = 0
    latency_ms: Latency | None = None
    deadline: Deadline | None = None
    robustness: Robustness | None = None
    """With the undegraded scores as strength 0."""
    times: Times = Times()
    peak_rss_mb: Number = None

    def curves(self) -> Iterator[tuple[str, tuple[float | None, ...]]]:
        """Every curve, those under other conditions included."""
        yield from super().curves()
        for at in self.deadline.rates if self.deadline else ():
            yield from at.f1.items()
        for points in self.robustness.kinds.values() if self.robustness else ():
            for point in points:
                yield from point.f1.items()


class PooledSummary(ScopeSummary):
    """One tracker on all recordings together, of those that it completed."""

    recordings_complete: int = 0
    recordings_expected: int = 0


def curves_of(scores: Mapping[str, ResultModel]) -> Iterator[tuple[str, tuple[float | None, ...]]]:
    """Every curve of these scores, with the key of the scores."""
    for name, one in scores.items():
        yield from ((name, curve) for key, curve in one if isinstance(curve, tuple) and key != "confusion")
