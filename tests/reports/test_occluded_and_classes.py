"""Occluded cells and classes on the page; a section without content is left out."""

import json
from pathlib import Path

import pytest

from gridtrack.evaluation.runs.result_files import RunError
from gridtrack.reports.classes import class_tables
from gridtrack.reports.occluded_thresholds import occluded_thresholds
from gridtrack.reports.page import render_report
from gridtrack.reports.run import read_runs
from gridtrack.reports.table import headline_tables

STEPS = 20


def with_truth(run):
    """The run as one of a recording with truth and classes leaves it."""
    summary = json.loads((run / "summary.json").read_text())
    for label, entry in summary["trackers"].items():
        for trial in entry["recordings"].values():
            strata = trial["strata"]
            strata["occluded"] = {**strata["visible"], "f1": [0.25] * (STEPS + 1)}
            strata["occluded to 0.5 s"] = {**strata["visible"], "f1": [0.5] * (STEPS + 1)}
            trial["gap_to_truth"] = [0.125] * (STEPS + 1)
            found = {"recall": [0.75] * (STEPS + 1), "recall_at_half": [0.5] * (STEPS + 1), "cells": [9] * (STEPS + 1)}
            trial["recall_by_class"] = {"visible": {"<b>bus</b>": found, "car": {**found, "cells": [0] * (STEPS + 1)}}}
            if label == "good":
                curves = ("nll_per_cell", "nll_per_scan", "nll_summed_over_scans", "balanced_accuracy")
                scores = dict.fromkeys(curves, [0.625] * (STEPS + 1))
                scores |= dict.fromkeys(("cells", "scans"), [9] * (STEPS + 1))
                ends = {
                    "nll_per_scan_low": [0.5] * (STEPS + 1),
                    "nll_per_scan_high": [0.75] * (STEPS + 1),
                    "interval": "",
                }
                trial["semantics"] = {"classes": ["<b>bus</b>", "car"], "kinds": {"visible": {**scores, **ends}}}
    less = {"nll_per_scan": [-0.375] * (STEPS + 1), "nll_per_scan_low": [-0.5] * (STEPS + 1)}
    less |= {"nll_per_scan_high": [None] + [-0.25] * STEPS, "nll_per_scan_p": [0.5] * (STEPS + 1)}
    summary["class_differences"] = [
        {"recordings": "crossing", "tracker": "good", "reference": "<i>one-shot</i>", "kinds": {"visible": less}}
    ]
    (run / "summary.json").write_text(json.dumps(summary))
    return run


@pytest.fixture
def truth_run(make_run, tmp_path):
    return with_truth(make_run(tmp_path / "truth"))


def table_of(run):
    (table,) = headline_tables(read_runs([run]))
    return table


def test_classes_that_occur_have_a_column_and_trackers_without_semantics_no_row(truth_run):
    classes = class_tables(table_of(truth_run), *read_runs([truth_run]))
    assert classes.recall_columns == (("visible", "<b>bus</b>"),)
    assert [(row.label, recalls) for row, recalls in classes.recalls][:2] == [("good", (0.75,)), ("fair", (0.75,))]
    assert [one.row.label for one in classes.rows] == ["good"]
    assert classes.columns == (("visible", "now"), ("visible", "1 s"))


def test_class_probabilities_have_an_interval_and_a_difference_from_the_reference(truth_run):
    classes = class_tables(table_of(truth_run), *read_runs([truth_run]))
    now, then = classes.rows[0].cells
    assert (then.loss, then.interval, then.accuracy) == (0.625, (0.5, 0.75), 0.625)
    assert (then.difference, then.difference_interval) == (-0.375, (-0.5, -0.25))
    assert (now.difference, now.difference_interval) == (-0.375, None)
    page = render_report([truth_run]).read_text()
    assert "0.625<small>[0.500, 0.750]</small><small>-0.375 [-0.500, -0.250]</small>" in page
    assert "less &lt;i&gt;one-shot&lt;/i&gt;" in page


def test_several_runs_side_by_side_have_no_differences(truth_run):
    assert class_tables(table_of(truth_run), None).rows[0].cells[0].difference is None


def test_the_page_shows_them_with_every_name_escaped(truth_run):
    page = render_report([truth_run]).read_text()
    for heading in ("Hidden cells by threshold", "Classes"):
        assert f"<h2>{heading}</h2>" in page
    assert "&lt;b&gt;bus&lt;/b&gt;" in page
    assert "<b>bus" not in page


def test_a_run_without_truth_has_no_such_section(run_folder):
    assert class_tables(table_of(run_folder), *read_runs([run_folder])) is None
    page = render_report([run_folder], run_folder / "page").read_text()
    assert "<h2>Hidden cells by threshold</h2>" not in page


def test_curves_by_class_that_do_not_reach_every_horizon_are_refused(truth_run):
    path = Path(truth_run / "summary.json")
    summary = json.loads(path.read_text())
    summary["trackers"]["good"]["recordings"]["crossing"]["semantics"]["kinds"]["visible"]["nll_per_cell"].pop()
    path.write_text(json.dumps(summary))
    with pytest.raises(RunError, match="good on crossing"):
        read_runs([truth_run])


def test_class_differences_that_do_not_reach_every_horizon_are_refused(truth_run):
    path = Path(truth_run / "summary.json")
    summary = json.loads(path.read_text())
    summary["class_differences"][0]["kinds"]["visible"]["nll_per_scan"].pop()
    path.write_text(json.dumps(summary))
    with pytest.raises(RunError, match="good on crossing: differences not of 21 steps"):
        read_runs([truth_run])


def with_thresholds(run, **f1):
    """The run with these F1 of occluded cells at the thresholds chosen with the truth, of visible cells, and 0.5."""
    summary = json.loads((run / "summary.json").read_text())
    for label, values in f1.items():
        occluded = summary["trackers"][label]["recordings"]["crossing"]["strata"]["occluded"]
        for name, value in zip(("f1", "f1_at_visible", "f1_at_half"), values, strict=True):
            occluded[name] = [value] * (STEPS + 1)
    less = {"value": [-0.125] * (STEPS + 1), "low": [-0.25] * (STEPS + 1), "high": [0.0] * (STEPS + 1)}
    summary["occluded_differences"] = [
        {
            "recordings": "crossing",
            "tracker": "good",
            "reference": "persistence",
            "scores": {"f1_at_half": {**less, "p": [0.04] * (STEPS + 1)}},
        }
    ]
    (run / "summary.json").write_text(json.dumps(summary))
    return run


def test_occluded_cells_are_shown_at_three_thresholds_with_the_difference_from_the_reference(truth_run):
    run = with_thresholds(truth_run, good=(0.6, 0.5, 0.4), fair=(0.5, 0.4, 0.3))
    shown = occluded_thresholds(table_of(run), read_runs([run])[0])
    scores = {row.label: found for row, found in shown.rows}
    assert [score.value for score in scores["good"][:3]] == [0.6, 0.5, 0.4]
    assert scores["good"][3].value is not None, "the log loss is shown too"
    assert (scores["good"][2].difference, scores["good"][2].interval) == ("-0.125", "[-0.250, +0.000]")
    assert scores["good"][2].p == "p = 0.040"
    assert not scores["fair"][2].difference
    assert (shown.reference, shown.turned) == ("persistence", False)


def test_the_page_says_where_the_order_on_occluded_cells_depends_on_the_threshold(truth_run):
    run = with_thresholds(truth_run, good=(0.6, 0.2, 0.1), fair=(0.5, 0.4, 0.3))
    html = render_report([run]).read_text()
    assert "The order depends on the threshold." in html
    assert "-0.125 [-0.250, +0.000]" in html
    assert "p-values are not corrected" in html


def test_where_there_is_no_p_value_nothing_is_said_of_their_correction(truth_run):
    html = render_report([truth_run]).read_text()
    assert "<h2>Hidden cells by threshold</h2>" in html
    assert "p-values are not corrected" not in html
