"""What the page's scripts know of the runs, as JSON: one key for each thing that they show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from gridtrack.common.grid import GridSpec
from gridtrack.evaluation.runs.result_files import Curve
from gridtrack.evaluation.runs.summary import StratumScores, TrialSummary, better_direction
from gridtrack.reports.conditions import condition_texts, conditions_of
from gridtrack.reports.label_budget import label_budget_of
from gridtrack.reports.moment_packing import level_colours
from gridtrack.reports.probability_curves import ProbabilityCurves
from gridtrack.reports.run import ReportedRun
from gridtrack.reports.table import HeadlineTable, TableColumn, TableRow
from gridtrack.reports.tiers import tiers_of
from gridtrack.reports.times import times_of

PAGE_SCORES = {
    "pr_auc": "PR-AUC",
    "f1": "F1",
    "precision": "Precision",
    "recall": "Recall",
    "nll": "Log loss, nats",
    "brier": "Brier score",
    "ece": "Calibration error",
    "ece_above_1_percent": "Calibration error, p ≥ 1 %",
    "f1_at_half": "F1 at 0.5",
    "f1_at_visible": "F1, threshold of visible cells",
    "f1_label_free": "F1, label-free threshold",
    "fss_1": "FSS, 1 cell",
    "fss_3": "FSS, 3 cells",
    "fss_5": "FSS, 5 cells",
    "fss_9": "FSS, 9 cells",
    "soft_iou": "Soft IoU",
    "beam_error": "Beam error, m",
    "beam_error_median": "Median beam error, m",
    "beam_bias": "Beam bias, m",
    "flow_error": "Flow error, m/s",
    "flow_speed": "True speed where flow is given, m/s",
    "flow_coverage": "Cells with flow",
    "energy_score": "Energy score",
    "energy_spread": "Spread of futures",
    "share_of_oracle": "Share of the oracle, F1",
    "share_of_oracle_nll": "Share of the oracle, log loss",
    "brier_reliability": "Brier: reliability",
    "brier_resolution": "Brier: resolution",
    "brier_uncertainty": "Brier: uncertainty",
    "threshold": "Threshold",
}
"""Scores that a reader can choose, and their names."""


def page_data(
    runs: Sequence[ReportedRun],
    tables: Sequence[HeadlineTable],
    styles: Mapping[str, str],
    curves: Mapping[tuple[str, str], ProbabilityCurves],
) -> dict[str, Any]:
    """The data of the page but the recordings that have a player, `players`, and what `priors.py` has, `priors`.

    `trackers`: the key of every row as `label`, its name in the first table that has it and its style (CSS classes), in
    the order of `styles`. `scores`: those that any row has. `headline`: what is shown first. `recordings`: for each the
    horizons, the rows in the order of the table with a curve for each stratum and score, its times, scores under other
    conditions, classes, `label_budget` and `bins` (of `curves`), the tiers by "score/stratum/step", and why there may
    be none. `conditions`: their names. `level_colours`: those of the cells of moments.
    """
    first = tables[0].decisive
    names = {row.key: row.name for table in reversed(tables) for row in table.rows}
    recordings = [_recording(runs, table, styles, curves) for table in tables]
    rows = [row for recording in recordings for row in recording["rows"]]
    had = {score for row in rows for curves in row["strata"].values() for score in curves} | {first.score}
    return {
        "trackers": [
            {"label": label, "name": names.get(label, label), "style": style} for label, style in styles.items()
        ],
        "scores": [
            {"key": key, "name": name, "better": better_direction(key)}
            for key, name in PAGE_SCORES.items()
            if key in had
        ],
        "headline": {"stratum": first.stratum, "score": first.score, "ahead_s": tables[0].horizons_s[first.step]},
        "recordings": recordings,
        "conditions": condition_texts(tables),
        "level_colours": level_colours(),
    }


def _recording(
    runs: Sequence[ReportedRun],
    table: HeadlineTable,
    styles: Mapping[str, str],
    curves: Mapping[tuple[str, str], ProbabilityCurves],
) -> dict[str, Any]:
    grids = {run.summary.recordings[table.recording].grid for run in runs if table.recording in run.summary.recordings}
    grid = grids.pop() if len(grids) == 1 else ""
    first = next(column for column in table.columns if column.score == "f1")
    return {
        "name": table.recording,
        "horizons_s": list(table.horizons_s),
        "period_ms": _period_ms(table),
        "cell_m": GridSpec.parse(grid).cell_m if grid else None,
        "conditions_ahead": first.heading,
        "conditions_ahead_s": table.horizons_s[first.step],
        "rows": [
            _row(row, styles[row.key], table, first)
            | {
                "bins": curves.get((table.recording, row.name)),
                "label_budget": label_budget_of(runs, table, row),
            }
            for row in table.rows
        ],
        "tiers": _tiers(runs[0], table.recording) if len(runs) == 1 else {},
        "untested": _why_untested(runs, table),
    }


def _period_ms(table: HeadlineTable) -> float:
    return round((table.horizons_s[1] - table.horizons_s[0]) * 1e3, 3)


def _row(row: TableRow, style: str, table: HeadlineTable, conditions_at: TableColumn) -> dict[str, Any]:
    return {
        "name": row.name,
        "label": row.key,
        "style": style,
        "group": row.group,
        "outcome": row.outcome,
        "strata": {name: _curves(scores, len(table.horizons_s)) for name, scores in row.trial.strata.items()},
        "latency": times_of(row.trial, _period_ms(table)),
        "conditions": conditions_of(row.trial, conditions_at),
        "classes": _classes(row.trial),
    }


def _classes(trial: TrialSummary) -> dict[str, Any] | None:
    """Names of the classes, and confusion matrices by visibility and step; None where there are none."""
    kinds = trial.semantics.kinds if trial.semantics else {}
    found = {name: {str(one.step): one.cells for one in scores.confusion} for name, scores in kinds.items()}
    known = {name: by_step for name, by_step in found.items() if by_step}
    return {"names": trial.semantics.classes, "confusion": known} if trial.semantics and known else None


def _curves(scores: StratumScores, steps: int) -> dict[str, list[float | None]]:
    """The scores that are defined anywhere, with the ends of their intervals as `_low` and `_high`."""
    names = (score + end for score in PAGE_SCORES for end in ("", "_low", "_high"))
    found: dict[str, Curve | None] = {name: getattr(scores, name, None) for name in names}
    return {
        name: [None if value is None else float(f"{value:.5g}") for value in curve[:steps]]
        for name, curve in found.items()
        if curve is not None and any(value is not None for value in curve)
    }


def _tiers(run: ReportedRun, recording: str) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for family in run.summary.pairs:
        if family.recordings == recording:
            key = f"{family.score}/{family.stratum}/{family.step}"
            one = found.setdefault(key, {"pairs": 0, "units": family.units, "groups": []})
            one["pairs"] += len(family.pairs)
            one["groups"] += tiers_of(family)
    return found


def _why_untested(runs: Sequence[ReportedRun], table: HeadlineTable) -> str:
    """Why the order of a ranking is not tested, where it is not."""
    if len(runs) > 1:
        return "rows of several runs"
    complete = [row.trial for row in table.rows if row.group in ("ranked", "floor")]
    why = next((scores.interval for trial in complete for scores in trial.strata.values() if scores.interval), "")
    return why or ("no two complete rows" if len(complete) < 2 else "no test of this score, stratum and horizon")
