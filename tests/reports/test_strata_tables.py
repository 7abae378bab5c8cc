"""Tables of hidden cells and of scores with strata of their own; a table without content is left out."""

import pytest

from gridtrack.evaluation.runs.result_files import RunError
from gridtrack.reports.page import render_report
from gridtrack.reports.run import read_runs
from gridtrack.reports.strata_tables import strata_tables
from gridtrack.reports.table import headline_tables

from scenes.edited_run import describe, edit, put, trial_of

THRESHOLDS = ("f1.f1", "f1.at_half", "f1.at_visible")
"""The outputs of F1 that are tested, in their order."""
BUS = "<b>bus</b>"


def with_truth(summary):
    """The summary as one of a recording with truth and classes."""
    describe(summary, "class_recall", "Recall by class", {"recall": {"better": "higher"}})
    loss = {"per_scan": {"better": "lower", "unit": "nats a scan", "tested": True}, "accuracy": {"better": "higher"}}
    describe(summary, "class_log_loss", "Class log loss", loss, compared_with="classes")
    for label in summary["trackers"]:
        trial = trial_of(summary, label)
        trial["strata"]["occluded"] = {name: dict(own) for name, own in trial["strata"]["visible"].items()}
        put(trial, "occluded", "f1.f1", 0.25)
        put(trial, f"dynamic {BUS}", "class_recall.recall", 0.75)
        put(trial, "dynamic car", "class_recall.recall", None)
    put(trial_of(summary, "good"), "visible", "class_log_loss.per_scan", 0.625, 0.5, 0.75)
    put(trial_of(summary, "good"), "visible", "class_log_loss.accuracy", 0.875)
    less = {"recordings": "crossing", "tracker": "good", "reference": "<i>one-shot</i>", "strata": {}}
    put(less, "visible", "class_log_loss.per_scan", -0.375, -0.5, [None] + [-0.25] * 20, 0.5)
    summary["differences"] = [less]


@pytest.fixture(scope="module")
def truth_run(make_run, tmp_path_factory):
    return edit(make_run(tmp_path_factory.mktemp("truth") / "run"), with_truth)


def tables_of(run, alone=True):
    (reported,) = read_runs([run])
    (table,) = headline_tables([reported])
    return {one.title: one for one in strata_tables(table, reported if alone else None)}


def shown(table, label):
    """The texts of a row: value, interval and difference with its interval."""
    (cells,) = [cells for row, cells in table.rows if row.label == label]
    return [(cell.text, cell.interval_text, less and f"{less.value} {less.interval}") for cell, less in cells]


def test_a_class_that_occurs_has_a_column_with_every_tracker(truth_run):
    recall = tables_of(truth_run)["Recall by class"]
    assert [column.heading for column in recall.columns] == [f"dynamic {BUS}"]
    assert [row.label for row, _ in recall.rows][:2] == ["good", "fair"]
    assert shown(recall, "fair") == [("0.750", "", None)]


def test_class_probabilities_have_an_interval_and_a_difference_from_their_reference_now_and_later(truth_run):
    loss = tables_of(truth_run)["Class log loss"]
    heading = "Class log loss"
    groups = [f"{heading}, nats a scan, now", f"{heading}, nats a scan, 1 s", f"{heading}, now", f"{heading}, 1 s"]
    assert loss.groups == tuple((group, 1) for group in groups)
    assert {column.heading for column in loss.columns} == {"visible"}
    assert [row.label for row, _ in loss.rows] == ["good"], "the others give no classes"
    now, later, accuracy, _ = shown(loss, "good")
    assert accuracy == ("0.875", "", None)
    assert later == ("0.625", "[0.500, 0.750]", "-0.375 [-0.500, -0.250]")
    assert now == ("0.625", "[0.500, 0.750]", "-0.375 ")
    assert loss.reference == "<i>one-shot</i>"
    assert tables_of(truth_run, alone=False)["Class log loss"].rows[0][1][0][1] is None, "runs side by side"


def test_the_page_shows_them_with_every_name_escaped(truth_run):
    page = render_report([truth_run]).read_text()
    for heading in ("Hidden cells by threshold", "Class log loss", "Recall by class"):
        assert f"<h2>{heading}</h2>" in page
    assert "0.625<small>[0.500, 0.750]</small><small>-0.375 [-0.500, -0.250]</small>" in page
    assert "less &lt;i&gt;one-shot&lt;/i&gt;" in page
    assert "About class_log_loss." in page
    assert "&lt;b&gt;bus&lt;/b&gt;" in page
    assert "<b>bus" not in page
    assert "The order depends on the threshold" not in page
    hidden = page.partition("<h2>Hidden cells by threshold</h2>")[2].partition("<h2>")[0]
    assert "p-values are not corrected" not in hidden, "there are none"


def test_a_run_without_truth_has_no_such_table(run_folder):
    assert tables_of(run_folder) == {}
    assert "<h2>Hidden cells by threshold</h2>" not in render_report([run_folder], run_folder / "page").read_text()


def test_differences_that_do_not_reach_every_horizon_are_refused(make_run, tmp_path):
    def shorten(summary):
        with_truth(summary)
        summary["differences"][0]["strata"]["visible"]["class_log_loss"]["per_scan"]["value"].pop()

    run = edit(make_run(tmp_path / "run"), shorten)
    with pytest.raises(RunError, match="good on crossing: differences, visible: 20 steps, expected 21"):
        read_runs([run])


@pytest.fixture
def with_thresholds(make_run, tmp_path):
    """`with_thresholds(good=(...))`: the run with these F1 of hidden cells at each of THRESHOLDS."""

    def with_thresholds(**f1):
        def change(summary):
            with_truth(summary)
            for label, values in f1.items():
                for output, value in zip(THRESHOLDS, values, strict=True):
                    put(trial_of(summary, label), "occluded", output, value)
            less = {"recordings": "crossing", "tracker": "good", "reference": "persistence", "strata": {}}
            put(less, "occluded", "f1.at_half", -0.125, -0.25, 0.0, 0.04)
            summary["differences"] = [less]

        return edit(make_run(tmp_path / "run"), change)

    return with_thresholds


def test_hidden_cells_are_shown_at_three_thresholds_with_the_difference_from_the_reference(with_thresholds):
    run = with_thresholds(good=(0.6, 0.5, 0.4), fair=(0.5, 0.4, 0.3))
    hidden = tables_of(run)["Hidden cells by threshold"]
    headings = [column.heading for column in hidden.columns]
    assert headings[:4] == ["F1", "F1 at 0.5", "F1, threshold of visible cells", "PR-AUC"]
    assert "Log loss, nats" in headings, "it needs no threshold, and is shown too"
    good = shown(hidden, "good")
    assert [value for value, _, _ in good[:3]] == ["0.600", "0.500", "0.400"]
    assert good[1][2] == "-0.125 [-0.250, +0.000]"
    assert [less for _, _, less in shown(hidden, "fair")] == [None] * len(headings)
    assert (hidden.reference, hidden.thresholds_matter) == ("persistence", False)


def test_the_page_says_if_the_order_on_hidden_cells_depends_on_the_threshold(with_thresholds):
    html = render_report([with_thresholds(good=(0.6, 0.2, 0.1), fair=(0.5, 0.4, 0.3))]).read_text()
    assert "The order depends on the threshold." in html
    assert "-0.125 [-0.250, +0.000]" in html
    assert "p = 0.040" in html
    assert "p-values are not corrected" in html
