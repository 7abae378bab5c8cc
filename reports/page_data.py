"""The data of the page's scripts, as JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from gridtrack.common.grid import GridSpec
from gridtrack.evaluation.runs.result_files import Curve
from gridtrack.evaluation.runs.summary import Estimate, Estimates
from gridtrack.reports.differences import groups_of
from gridtrack.reports.measurements import condition_texts, conditions_of, times_of
from gridtrack.reports.moments import level_colours
from gridtrack.reports.run import ReportedRun
from gridtrack.reports.score_figures import Figures
from gridtrack.reports.table import HeadlineTable, TableRow


def page_data(
    runs: Sequence[ReportedRun],
    tables: Sequence[HeadlineTable],
    styles: Mapping[str, str],
    figures: Mapping[tuple[str, str], Figures],
) -> dict[str, Any]:
    """The data of the page, without `players`, `opening`, `priors` and `left_out`, the number of recordings that do not
    fit.

    `trackers`: the key of every row as `label`, its name in its first table and its style (CSS classes), in the order
    of `styles`. `scores`: descriptions of all scores with a value, as in summary.json. `headline`: score, cells,
    horizon and reference at the start. `recordings`: whether `pooled`, horizons, classes, and the rows in the order of
    the table, with estimates by stratum, score and output as in summary.json, `figures`, times, scores under other
    conditions, and `label_budget`; also the groups of rows that do not differ significantly, by
    "score.output/stratum/step", or why there are none.
    `conditions`: their names. `level_colours`: the colours of the cells of moments.
    """
    first = tables[0].decisive
    names = {row.key: row.name for table in reversed(tables) for row in table.rows}
    recordings = [_recording(runs, table, styles, figures) for table in tables]
    strata = [scores for one in recordings for row in one["rows"] for scores in row["strata"].values()]
    had = {score for scores in strata for score in scores} | {first.score.name}
    described = {score.name: score for table in tables for score in (*table.scores, first.score)}
    return {
        "trackers": [
            {"label": label, "name": names.get(label, label), "style": style} for label, style in styles.items()
        ],
        "scores": [score.model_dump(exclude={"about"}) for name, score in described.items() if name in had],
        "headline": {
            "stratum": first.stratum,
            "score": first.name,
            "ahead_s": tables[0].horizons_s[first.step],
            "reference": _reference(runs, tables[0]),
        },
        "recordings": recordings,
        "conditions": condition_texts(tables),
        "level_colours": level_colours(),
    }


def _recording(
    runs: Sequence[ReportedRun],
    table: HeadlineTable,
    styles: Mapping[str, str],
    figures: Mapping[tuple[str, str], Figures],
) -> dict[str, Any]:
    described = [run.summary.recordings[table.recording] for run in runs if table.recording in run.summary.recordings]
    grids = {one.grid for one in described}
    grid = grids.pop() if len(grids) == 1 else ""
    period_ms = round((table.horizons_s[1] - table.horizons_s[0]) * 1e3, 3)
    step = next(column.step for column in table.columns if column.key == table.headline)
    leads = {score.name: score.lead.name for score in table.scores}
    return {
        "name": table.recording,
        "pooled": table.pooled,
        "horizons_s": list(table.horizons_s),
        "period_ms": period_ms,
        "cell_m": GridSpec.parse(grid).cell_m if grid else None,
        "classes": list(described[0].classes),
        "conditions_ahead_s": table.horizons_s[step],
        "rows": [
            {
                "name": row.name,
                "label": row.key,
                "style": styles[row.key],
                "group": row.group,
                "outcome": row.outcome,
                "remark": row.remark,
                "strata": _strata(row, len(table.horizons_s)),
                "figures": figures.get((table.recording, row.name), {}),
                "latency": times_of(row.trial, period_ms),
                "conditions": conditions_of(row.trial, leads, step),
                "label_budget": _label_budget(runs, table, row),
            }
            for row in table.rows
        ],
        "groups": _groups(runs[0], table.recording) if len(runs) == 1 else {},
        "false_difference": runs[0].summary.false_differences.get(table.recording) if len(runs) == 1 else None,
        "untested": _why_untested(runs, table),
    }


def _strata(row: TableRow, steps: int) -> dict[str, Any]:
    """The estimates by stratum, score and output, to five digits, without wholly undefined ones."""
    found = {stratum: _scores(scores, steps) for stratum, scores in row.trial.strata.items()}
    return {stratum: scores for stratum, scores in found.items() if scores}


def _scores(scores: Estimates, steps: int) -> dict[str, Any]:
    found = {
        score: {name: _estimate(one, steps) for name, one in outputs.items() if _is_defined(one.value)}
        for score, outputs in scores.items()
    }
    return {score: outputs for score, outputs in found.items() if outputs}


def _estimate(estimate: Estimate, steps: int) -> dict[str, Any]:
    curves = {"value": estimate.value, "low": estimate.low, "high": estimate.high}
    return {
        name: [None if value is None else float(f"{value:.5g}") for value in curve[:steps]]
        for name, curve in curves.items()
        if curve is not None and _is_defined(curve)
    }


def _is_defined(curve: Curve) -> bool:
    return any(value is not None for value in curve)


def _groups(run: ReportedRun, recording: str) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for family in run.summary.pairs:
        if family.recordings == recording:
            key = f"{family.score}.{family.output}/{family.stratum}/{family.step}"
            one = found.setdefault(key, {"pairs": 0, "units": family.units, "tested": [], "groups": []})
            one["pairs"] += len(family.pairs)
            one["tested"] += dict.fromkeys(label for pair in family.pairs for label in (pair.tracker, pair.other))
            one["groups"] += groups_of(family)
    return found


def _reference(runs: Sequence[ReportedRun], table: HeadlineTable) -> str:
    """The row that the others are compared with at the start: for several runs the best one of the first run."""
    rows = (row.key for row in table.rows_in("ranked") if row.run == runs[0].name)
    return next(rows, "") if len(runs) > 1 else ""


def _why_untested(runs: Sequence[ReportedRun], table: HeadlineTable) -> str:
    """Why the order of a ranking may not be tested."""
    if len(runs) > 1:
        return "rows of several runs"
    complete = [row.trial for row in table.rows if row.group in ("ranked", "floor")]
    why = next((trial.interval for trial in complete if trial.interval), "")
    return why or ("no two complete rows" if len(complete) < 2 else "no test of this score, stratum and horizon")


def _label_budget(runs: Sequence[ReportedRun], table: HeadlineTable, row: TableRow) -> dict[str, Any] | None:
    """The number of labelled `scans` in the training of a row's weights, and its `method`.

    `method`: the tracker with its options and points, equal for rows that differ only in their weights. None if the
    number of scans is unknown, or differs between pooled recordings.
    """
    run = next(run for run in runs if row.run in (run.name, ""))
    names = run.recordings if table.pooled else (table.recording,)
    scans = {used.labelled_scans for name in names if (used := run.record.weights.get(f"{row.label}@{name}"))}
    return {"scans": scans.pop(), "method": _method_of(row)} if len(scans) == 1 and None not in scans else None


def _method_of(row: TableRow) -> str:
    entry = row.entry
    options = [f"{name}={value}" for name, value in sorted(entry.options.items())]
    points = ["points=raw"] if entry.points == "raw" else []
    return f"{entry.tracker}:{','.join(options + points)}" if options or points else entry.tracker
