"""The figure of class log loss over labelled scans: which rows it has, and its lines in a browser."""

import csv

import pytest

from gridtrack.reports.page import render_page, render_report
from gridtrack.reports.run import read_runs

from scenes.edited_run import edit, edited, put, trial_of
from scenes.report_page import data_of, downloaded, opened

METHOD = "shot"
OUTPUT = {"name": "per_scan", "title": "Class log loss", "unit": "nats a scan", "better": "lower"}
CLASS_LOG_LOSS = {"name": "class_log_loss", "title": "Class log loss", "about": "", "thresholded": False}
CLASS_LOG_LOSS |= {"outputs": [OUTPUT], "compared_with": "classes"}


@pytest.fixture
def budget_run(run_folder, tmp_path):
    """`budget_run(scans, losses)`: a run with rows of one method and these numbers of labelled scans; None: unknown."""

    def budget_run(scans, losses, options=()):

        def with_losses(summary):
            summary["scores"].append(CLASS_LOG_LOSS)
            for label, loss in losses.items():
                summary["trackers"][label] |= {"tracker": METHOD, "options": dict(options).get(label, {})}
                put(trial_of(summary, label), "visible", "class_log_loss.per_scan", loss, loss - 0.125, loss + 0.125)

        def with_scans(record):
            for label, number in scans.items():
                used = {"name": "shot/crossing.toml", "sha256": label}
                used |= {} if number is None else {"labelled_scans": number}
                record.setdefault("weights", {})[f"{label}@crossing"] = used

        return edit(edited(run_folder, tmp_path / "run", with_losses), with_scans, "run.json")

    return budget_run


def budgets_of(run):
    (recording,) = data_of(render_page(read_runs([run])))["recordings"]
    return {row["label"]: row["label_budget"] for row in recording["rows"]}


def test_a_row_has_its_scans_and_its_method_and_none_if_they_are_not_known(budget_run):
    options = {"fair": {"evidence": "state"}}
    scans, losses = {"good": 50, "fair": 800, "blank": None}, {"good": 0.5, "fair": 0.25, "blank": 1.0}
    found = budgets_of(budget_run(scans, losses, options))
    assert {label: budget and (budget["scans"], budget["method"]) for label, budget in found.items()} == {
        "good": (50, METHOD), "fair": (800, f"{METHOD}:evidence=state"),
        "persistence": None, "blank": None, "unlucky": None,
    }  # fmt: skip


def test_a_browser_draws_a_line_with_its_band_without_a_row_that_is_off(browser, budget_run):
    losses = {"good": 0.25, "fair": 0.5, "unlucky": 0.75, "blank": 0.625}
    run = budget_run({"good": 800, "fair": 200, "unlucky": 50, "blank": 50}, losses)
    with opened(browser, render_report([run])) as page:
        figure = page.locator("#label-budget")
        assert figure.locator("polyline").count() == 1
        dots = figure.locator("circle.dot").evaluate_all("dots => dots.map((dot) => getComputedStyle(dot).fill)")
        assert len(set(dots)) == 3, "each in the colour of its row"
        assert figure.locator(".line polyline").get_attribute("points").count(",") == 3, (
            "rows with 50 scans are one point"
        )
        assert figure.locator(".tick").all_text_contents()[-3:] == ["50", "200", "800"]
        figure.locator(".chart").focus()
        page.keyboard.press("ArrowRight")
        assert "50 labelled scans" in figure.locator(".readout").text_content()
        assert "0.688 (mean of 2 rows)" in figure.locator(".readout").text_content()
        rows = list(csv.DictReader(downloaded(page, "#label-budget").splitlines()))
        (good,) = [row for row in rows if row["tracker"] == "good"]
        assert (good["labelled scans"], good["class_log_loss"], good["low"]) == ("800", "0.25", "0.125")
        page.get_by_role("button", name="fair", exact=True).click()
        assert figure.locator(".tick").all_text_contents()[-2:] == ["50", "800"]
