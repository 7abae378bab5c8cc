"""Scores on several recordings: their table and distribution, and the way from there to a recording."""

import csv
import re
import statistics

import pytest

from gridtrack.evaluation.runs.summary import read_summary
from gridtrack.reports.page import render_report

from scenes.edited_run import edited, value_of, with_again
from scenes.report_page import HOSTILE, downloaded, opened

ONE_S = 2
"""The step of one second in the run of twenty recordings."""


@pytest.fixture(scope="module")
def page(browser, twenty_report):
    with opened(browser, twenty_report, viewport={"width": 1280, "height": 900}) as page:
        page.locator("#recordings").get_by_label("Score").select_option("F1")
        yield page


@pytest.fixture(scope="module")
def f1(twenty):
    """F1 on cells in motion 1 s ahead by tracker and recording."""
    return {
        label: {name: trial.at("in-motion", "f1", "f1", ONE_S).value for name, trial in row.recordings.items()}
        for label, row in read_summary(twenty).trackers.items()
    }


def lines_of(page):
    """The recordings of the table in their order, with their cells."""
    rows = page.locator("#recordings .matrix tbody:last-child tr").all_inner_texts()
    return [row.split() for row in rows]


def test_the_table_has_the_score_of_every_tracker_on_every_recording(page, f1):
    heads = page.locator("#recordings .matrix thead th").all_inner_texts()
    assert heads[0] == "recording"
    assert sorted(heads[1:]) == sorted(f1)
    lines = lines_of(page)
    assert [name for name, *_ in lines] == [*f1["good"]]
    for name, *cells in lines:
        for label, cell in zip(heads[1:], cells, strict=True):
            shown = f"{f1[label][name]:.3f}"
            assert cell == (f"({shown})" if (label, name) == ("unlucky", "seed-00") else shown), "in parentheses"
    assert page.locator("#recordings .together tr").count() == 1, "the pooled score"


def test_the_best_complete_row_of_a_recording_is_bold_and_never_the_ceiling(page):
    heads = page.locator("#recordings .matrix thead th").all_inner_texts()
    bold = page.locator("#recordings .matrix td:has(b)").evaluate_all("all => all.map((one) => one.cellIndex)")
    assert len(bold) >= 21
    assert "oracle" not in {heads[i] for i in bold}


def test_a_column_sorts_both_ways_by_keyboard_and_the_first_restores_the_order(page, f1):
    head = page.locator("#recordings thead th", has_text="good")
    head.get_by_role("button").focus()
    ranked = sorted(f1["good"], key=f1["good"].get)
    for names, direction in ((ranked[::-1], "descending"), (ranked, "ascending")):
        page.keyboard.press("Enter")
        assert [name for name, *_ in lines_of(page)] == names
        assert head.get_attribute("aria-sort") == direction
        assert page.evaluate("document.activeElement.textContent") == "good"
    table = page.get_by_role("region", name="Recordings and trackers")
    table.get_by_role("button", name="recording", exact=True).click()
    assert [name for name, *_ in lines_of(page)] == [*f1["good"]]
    assert page.locator("#recordings th[aria-sort=ascending], #recordings th[aria-sort=descending]").count() == 0


def test_the_distribution_has_a_dot_for_each_recording_and_their_median(page, f1):
    drawing = page.locator("#recordings svg.figure-drawing")
    for row in drawing.locator("g.line").all():
        name = row.locator("title").text_content()
        assert row.locator("circle.dot").count() == 20
        assert row.locator("text").last.text_content() == f"{statistics.median(f1[name].values()):.3f}"
    assert drawing.locator("path.pairs").count() == 20
    assert drawing.locator(".partial").count() == 1


def test_the_arrows_read_a_recording_and_enter_leads_to_it(page, f1):
    page.locator("#recordings .spread-of-recordings").focus()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowDown")
    read = page.locator("#recordings .readout").inner_text()
    assert read.startswith("seed-01")
    assert f"good {f1['good']['seed-01']:.3f}" in read
    page.keyboard.press("Enter")
    assert page.locator("#ranking select").first.input_value() == "seed-01"
    assert page.evaluate("document.activeElement.closest('section').id") == "ranking", "the run has no moments"
    page.locator("#recordings").get_by_role("button", name="all recordings").click()
    assert page.locator("#ranking select").first.input_value() == "all recordings"


def test_a_click_on_a_dot_leads_to_its_recording_and_one_beside_it_to_none(page):
    drawing = page.locator("#recordings svg.figure-drawing")
    drawing.locator("circle.dot").last.click(force=True)
    read = page.locator("#recordings .readout b").inner_text()
    assert page.locator("#ranking select").first.input_value() == read
    page.locator("#ranking select").first.select_option("all recordings")
    drawing.click(position={"x": 5, "y": 5})
    assert page.locator("#ranking select").first.input_value() == "all recordings"


def test_a_hidden_tracker_leaves_table_and_distribution_and_their_file(page):
    button = page.locator("#trackers").get_by_role("button", name="good", exact=True)
    button.click()
    heads = page.locator("#recordings .matrix thead th").all_inner_texts()
    assert "good" not in heads
    assert "persistence" in heads
    assert page.locator("#recordings g.line title").all_text_contents().count("good") == 0
    rows = list(csv.DictReader(downloaded(page, "#recordings").splitlines()))
    button.click()
    assert len(rows) == 4 * 20
    assert {(row["tracker"], row["group"]) for row in rows} >= {("persistence", "floor"), ("unlucky", "unranked")}
    assert (rows[0]["recording"], rows[0]["stratum"], rows[0]["score"]) == ("seed-00", "in-motion", "f1")


@pytest.fixture(scope="module")
def two(browser, run_folder, tmp_path_factory):
    """The page of a run on two recordings with moments and times; every score is lower on the second."""

    def lower(_, again):
        for scores in again.values():
            for outputs in scores.values():
                for estimate in outputs.values():
                    estimate["value"] = [None if value is None else 0.5 * value for value in estimate["value"]]

    run = with_again(run_folder, tmp_path_factory.mktemp("two") / "run", lower)
    with opened(browser, render_report([run]), viewport={"width": 400, "height": 900}, color_scheme="dark") as page:
        yield page


def test_a_recording_of_the_table_is_chosen_in_every_figure_and_leads_to_its_moments(two):
    two.locator("#recordings").get_by_role("button", name="again", exact=True).click()
    chosen = two.locator("select[data-choice=Recording]").evaluate_all("all => all.map((one) => one.value)")
    assert len(chosen) > 5
    assert set(chosen) == {"again"}
    assert two.evaluate("document.activeElement.closest('section').id") == "moments"
    assert two.locator("#moments").bounding_box()["y"] < 900


def test_axe_finds_nothing_serious_on_a_page_of_several_recordings(two, serious_findings):
    assert serious_findings(two) == []
    assert two.evaluate("document.documentElement.scrollWidth <= innerWidth")


def test_slices_are_two_rows_with_their_difference(opened, summary_of, run_folder):
    page, _ = opened()
    assert page.locator("#recordings").count() == 0, "the run has one"
    figure = page.locator("#slices")
    figure.get_by_label("Score").select_option("F1")
    figure.get_by_label("Tracker").select_option("good")
    figure.get_by_label("Beside").select_option(label="persistence")
    trackers = summary_of(run_folder)["trackers"]
    trials = [trackers[label]["recordings"]["crossing"] for label in ("good", "persistence")]
    names = figure.locator("svg > text:has(tspan)").all_text_contents()
    assert set(names) == {name for name, scores in trials[0]["strata"].items() if "f1" in scores}
    numbers = figure.locator("svg > text[text-anchor=end]:not(.tick, .axis-name)").all_text_contents()
    one, other = (value_of(trial, "in-motion", "f1.f1", 8) for trial in trials)
    assert dict(zip(names, numbers, strict=True))["in-motion"] == f"+{one - other:.3f}"
    assert figure.locator(".legend").inner_text().split() == ["good", "persistence"]
    assert figure.get_by_label("Beside").locator("option", has_text="good").count() == 0, "no row beside itself"


def test_a_score_stands_over_the_time_with_every_name_beside_the_plot(opened):
    page, _ = opened()
    figure = page.locator("#score-and-time")
    assert "shaded: longer than a frame, 125 ms" in figure.locator(".note").inner_text()
    names = figure.locator("g.line > title").all_text_contents()
    assert {"good", HOSTILE, "persistence"} <= set(names)
    rows = csv.DictReader(downloaded(page, "#score-and-time").splitlines())
    (good,) = [row for row in rows if row["tracker"] == "good"]
    assert good["p99, ms"] == "44", "4 ms of an update and 40 ms of a forecast"
    period = float(figure.locator("line.period").get_attribute("x1"))
    assert all(float(dot.get_attribute("cx")) < period for dot in figure.locator("circle.dot").all())


def test_the_time_beside_a_pooled_score_is_that_on_the_slowest_recording(browser, twenty, tmp_path):
    def with_times(summary):
        for i, trial in enumerate(summary["trackers"]["good"]["recordings"].values()):
            update, predict = ({"p50": 1.0, "p95": 1.0, "p99": ms, "twentieths": []} for ms in (1.0 + i, 600.0))
            trial["latency_ms"] = {"update": update, "predict": predict, "predict_step": {"p50": 1, "p95": 1, "p99": 1}}

    with opened(browser, render_report([edited(twenty, tmp_path / "run", with_times)])) as page:
        figure = page.locator("#score-and-time")
        assert figure.get_by_label("Recording").input_value() == "all recordings"
        assert re.search(r"^good 0\.\d+, 620 ms$", figure.locator("svg.figure-drawing").get_attribute("aria-label"))
        (dot,) = figure.locator("circle.dot").all()
        assert float(dot.get_attribute("cx")) > float(figure.locator("line.period").get_attribute("x1"))
