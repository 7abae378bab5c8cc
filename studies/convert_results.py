"""Results of gridtrack 0.2 in the form of 0.3: the summaries that the pages are filled from.

`python -m studies.convert_results docs/results/*/summary.json` (a second) replaces each file with schema 2 by the same
numbers with schema 3. Confusion matrices are left out: they are figures of the report now. The script goes with the
last result of 0.2.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from gridtrack.evaluation.runs.summary import RunSummary, ScoreDescription
from gridtrack.evaluation.scores.registry import built_in

from studies.support.results_file import study_parser

OUTPUTS = {
    "f1": ("f1", "f1"),
    "precision": ("f1", "precision"),
    "recall": ("f1", "recall"),
    "f1_at_half": ("f1", "at_half"),
    "f1_at_visible": ("f1", "at_visible"),
    "f1_label_free": ("f1", "label_free"),
    "share_of_oracle": ("f1", "oracle_share"),
    "pr_auc": ("pr_auc", "area"),
    "nll": ("log_loss", "mean"),
    "share_of_oracle_nll": ("log_loss", "oracle_share"),
    "brier": ("brier", "mean"),
    "brier_reliability": ("brier", "reliability"),
    "brier_resolution": ("brier", "resolution"),
    "brier_uncertainty": ("brier", "uncertainty"),
    "ece": ("calibration", "error"),
    "ece_above_1_percent": ("calibration", "above_1_percent"),
    "fss_1": ("fss", "1_cells"),
    "fss_3": ("fss", "3_cells"),
    "fss_5": ("fss", "5_cells"),
    "fss_9": ("fss", "9_cells"),
    "soft_iou": ("soft_iou", "iou"),
    "beam_error": ("beam_error", "mean"),
    "beam_error_median": ("beam_error", "median"),
    "beam_bias": ("beam_error", "bias"),
    "flow_error": ("flow_error", "mean"),
    "flow_speed": ("flow_error", "true_speed"),
    "flow_coverage": ("flow_error", "coverage"),
    "energy_score": ("energy", "score"),
    "energy_spread": ("energy", "spread"),
    "nll_per_scan": ("class_log_loss", "per_scan"),
    "nll_summed_over_scans": ("class_log_loss", "summed_over_scans"),
    "nll_per_cell": ("class_log_loss", "per_cell"),
    "balanced_accuracy": ("class_log_loss", "balanced_accuracy"),
    "cells": ("class_log_loss", "cells"),
    "scans": ("class_log_loss", "scans"),
}
"""Score and output of each field of schema 2."""
ENDS = ("low", "high", "p")
Json = dict[str, Any]


def main(arguments: Sequence[str] | None = None) -> None:
    """Replace the files that the command line names."""
    parser = study_parser(__doc__)
    parser.add_argument("files", type=Path, nargs="+")
    for path in parser.parse_args(arguments).files:
        old = json.loads(path.read_text("utf-8"))
        if old["schema"] == 2:
            new = RunSummary.model_validate(converted(old))
            path.write_text(json.dumps(new.model_dump(mode="json", by_alias=True, exclude_none=True)) + "\n", "utf-8")
            print(f"{path}: schema 3")


def converted(old: Json) -> Json:
    """A summary of schema 2 as one of schema 3."""
    rows = {label: _row(row) for label, row in old["trackers"].items()}
    shown = {
        score
        for row in rows.values()
        for scope in (row.get("pooled"), *row["recordings"].values())
        for scores in (scope or {}).get("strata", {}).values()
        for score in scores
    }
    kept = ("interrupted", "notices", "recordings", "pooled_horizons_s", "reference")
    return {
        "schema": 3,
        **{name: old[name] for name in kept if name in old},
        "scores": [ScoreDescription.of(one).model_dump() for one in built_in() if one.name in shown],
        "trackers": rows,
        "differences": _differences(old),
        "pairs": [_family(one) for one in old["pairs"]],
        "trainings": [_trainings(one) for one in old["trainings"]],
    }


def _row(row: Json) -> Json:
    pooled = row.get("pooled")
    recordings = {name: _scope(one) for name, one in row["recordings"].items()}
    return {**row, "recordings": recordings, "pooled": pooled and _scope(pooled)}


def _scope(old: Json) -> Json:
    strata = {name: estimates(scores) for name, scores in old["strata"].items()}
    for visibility, by_class in (old.get("recall_by_class") or {}).items():
        stratum = {"visible": "dynamic", "occluded": "occluded"}[visibility]
        for name, one in by_class.items():
            found = {"recall": one["recall"], "at_half": one["recall_at_half"], "cells": one["cells"]}
            outputs = {output: {"value": curve} for output, curve in found.items()}
            strata[f"{stratum} {name}"] = {"class_recall": outputs}
    for visibility, scores in ((old.get("semantics") or {}).get("kinds") or {}).items():
        strata[visibility] = strata.get(visibility, {}) | estimates(scores)
    if (gap := old.get("gap_to_truth")) is not None:
        strata["occluded"]["f1"]["truth_gap"] = {"value": gap}
    return {
        **{name: value for name, value in old.items() if name not in ("semantics", "recall_by_class", "gap_to_truth")},
        "strata": strata,
        "thresholds": {name: scores["threshold"] for name, scores in old["strata"].items()},
        "interval": next((scores["interval"] for scores in old["strata"].values() if scores["interval"]), ""),
    }


def estimates(old: Json) -> Json:
    """Fields of schema 2, such as `f1` and `f1_low`, by score and output."""
    found: Json = {}
    for field, (score, output) in OUTPUTS.items():
        if (value := old.get(field)) is not None:
            ends = {end: old[key] for end in ENDS if old.get(key := f"{field}_{end}") is not None}
            found.setdefault(score, {})[output] = {"value": value, **ends}
    return found


def _differences(old: Json) -> list[Json]:
    """The differences of occupancy with those on hidden cells, then those of classes."""
    fields = ("recordings", "tracker", "reference", "units", "frames", "interval")
    hidden = {(one["recordings"], one["tracker"]): one["scores"] for one in old.get("occluded_differences", [])}
    found = []
    for one in old["differences"]:
        strata = {name: estimates(curves) for name, curves in one["strata"].items()}
        for field, curves in hidden.get((one["recordings"], one["tracker"]), {}).items():
            score, output = OUTPUTS[field]
            strata.setdefault("occluded", {}).setdefault(score, {})[output] = curves
        steps = len(next(iter(one["strata"].values()))["f1"]) if one["strata"] else 0
        for test in one["headline"]:
            _add_points(strata.setdefault(test["stratum"], {}), test, steps)
        tests = [
            {key: test[key] for key in ("stratum", "horizon_s", "step", "p_holm", "verdict")}
            for test in one["headline"]
        ]
        found.append({**{field: one[field] for field in fields}, "strata": strata, "tests": tests})
    for one in old.get("class_differences", []):
        strata = {visibility: estimates(curves) for visibility, curves in one["kinds"].items()}
        found.append({**{field: one[field] for field in fields}, "strata": strata})
    return found


def _add_points(scores: Json, test: Json, steps: int) -> None:
    """The differences of one headline test, known at its step alone, as curves."""
    for field, (score, output) in OUTPUTS.items():
        if field == "f1" or test.get(field) is None:
            continue
        curves = scores.setdefault(score, {}).setdefault(output, {end: [None] * steps for end in ("value", *ENDS)})
        for end, key in (("value", field), *((end, f"{field}_{end}") for end in ENDS)):
            curves[end][test["step"]] = test.get(key)


def _family(one: Json) -> Json:
    score, output = OUTPUTS[one["score"]]
    pairs = [
        {
            "tracker": pair["tracker"],
            "other": pair["other"],
            "difference": {"value": pair["difference"], **{end: pair[end] for end in ENDS}},
            "p_holm": pair["p_holm"],
            "verdict": pair["verdict"],
        }
        for pair in one["pairs"]
    ]
    return {**one, "score": score, "output": output, "pairs": pairs}


def _trainings(one: Json) -> Json:
    scores = [
        {
            "stratum": score["stratum"],
            "horizon_s": score["horizon_s"],
            "step": score["step"],
            "values": score["f1"],
            "mean": score["f1_mean"],
            "spread": score["f1_spread"],
            "difference": {"value": score["difference"], **{end: score[f"difference_{end}"] for end in ENDS}},
            "p_holm": score["p_holm"],
            "verdict": score["verdict"],
        }
        for score in one["scores"]
    ]
    return {**one, "scores": scores}


if __name__ == "__main__":
    main()
