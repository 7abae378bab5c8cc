"""Axis names of charts, on the page and in files; a row with general weights has one name everywhere."""

import re
from xml.etree import ElementTree

import pytest

from scenes.edited_run import put, robustness, trial_of
from scenes.report_page import HOSTILE, downloaded
from scenes.report_page import opened as page_opened

AXES = {
    "curves": ("horizon, s", "PR-AUC"),
    "score-and-time": ("99th percentile of update and forecast, ms", "PR-AUC"),
    "scale": ("side in cells", "Fractions skill score"),
    "precision-recall": ("recall", "precision"),
    "threshold": ("threshold", "F1"),
    "calibration": ("forecast probability", "share occupied"),
}
INSIDE = """svg => {
  const box = svg.getBoundingClientRect();
  return [...svg.querySelectorAll("text")].filter((one) => {
    const { left, right, top, bottom } = one.getBoundingClientRect();
    return left < box.left - 1 || right > box.right + 1 || top < box.top - 1 || bottom > box.bottom + 1;
  }).map((one) => one.textContent);
}"""

SAID = """() => {
  document.querySelectorAll(".facts, script").forEach((one) => one.remove());
  const of = (name) => [...document.querySelectorAll(`[${name}]`)].map((one) => one.getAttribute(name));
  const options = [...document.querySelectorAll("option, svg text, svg title")].map((one) => one.textContent);
  return [document.querySelector("main").innerText, ...of("aria-label"), ...options].join("\\n");
}"""
"""All text of a page, also in menus and labels, without the setup."""


@pytest.mark.parametrize("width", [1280, 400])
def test_a_chart_names_both_axes_within_the_drawing(opened, width):
    page, _ = opened(width=width)
    for figure, names in AXES.items():
        drawing = page.locator(f"#{figure} svg.figure-drawing")
        assert drawing.locator("text.axis-name").all_text_contents() == list(names)
        assert drawing.evaluate(INSIDE) == []
    for figure, name in (("ranking", "PR-AUC"), ("slices", "PR-AUC"), ("latency", "update, ms")):
        assert page.locator(f"#{figure} text.axis-name").all_text_contents() == [name]


def test_with_every_tracker_off_a_chart_says_so_without_an_error(opened):
    page, _ = opened()
    for button in page.locator("#trackers button").all():
        button.click()
    drawings = page.locator("section.figure .drawn svg.figure-drawing")
    assert drawings.count() > 5
    assert {one.strip() for one in drawings.all_text_contents()} == {"No shown tracker has a value here"}


def with_curves(values):
    """A change of a summary: PR-AUC on cells in motion has these `values` in every row."""

    def change(summary):
        for label in summary["trackers"]:
            put(trial_of(summary, label), "in-motion", "pr_auc.area", values)

    return change


def test_a_ranking_of_cells_that_no_frame_has_says_so(opened_with):
    page = opened_with(with_curves([0.4, *[None] * 20]))
    assert page.locator("#ranking .drawn").text_content() == "No shown tracker has a value here"


def test_the_input_frame_does_not_scale_the_axis_of_the_horizon(opened_with):
    page = opened_with(with_curves([1.0, *[0.2] * 20]))
    ticks = page.locator("#curves svg.figure-drawing .tick[text-anchor=end]").all_text_contents()
    assert "0.2" in ticks
    assert not {"0.4", "0.6", "1"} & set(ticks)
    lines = page.locator("#curves svg svg")
    assert lines.evaluate("one => getComputedStyle(one).overflow") in ("hidden", "clip")
    assert lines.locator("polyline").count()


def test_an_axis_without_zero_names_its_first_value(browser, twenty_report):
    with page_opened(browser, twenty_report) as page:
        name = page.locator("#ranking text.axis-name").text_content()
    assert re.fullmatch(r"F1; the axis begins at 0\.\d+", name)


def test_the_file_of_a_chart_stands_alone(opened):
    page, _ = opened()
    svg = downloaded(page, "#threshold", "SVG")
    texts = [" ".join(one.itertext()) for one in ElementTree.fromstring(svg).iter("{http://www.w3.org/2000/svg}text")]
    assert texts[0] == "Threshold"
    assert any("Recording: crossing; Cells: in-motion cells; Ahead: 1 s" in one for one in texts)
    assert any("F1 at every threshold." in one for one in texts)
    legend = page.locator("#threshold g.line > title").all_text_contents()
    assert legend
    assert HOSTILE in legend
    assert set(legend) <= set(texts)
    assert {"threshold", "F1"} <= set(texts)
    assert all("font-size: 1" in style for style in re.findall(r'<text [^>]*style="([^"]*)', svg))
    assert page.locator("svg.figure-drawing").count() == page.locator(".drawn svg.figure-drawing").count()


def test_the_figure_of_conditions_counts_contacts_as_the_ranking_does(opened_with):
    measured = robustness("beam_dropout", 0.2, "contact_foresight")
    page = opened_with(lambda summary: trial_of(summary, "good").update(robustness=measured))
    options = page.locator("#conditions select[data-choice=Contacts] option").all_inner_texts()
    assert {"in-motion contacts", "dynamic contacts"} <= set(options)
    assert all(one.endswith(" contacts") for one in options)


@pytest.mark.parametrize("width", [1280, 400])
def test_the_ranking_of_contacts_has_the_needless_stops_beside_it(opened_with, width):
    def foresee(summary):
        for label, foreseen, stops in (("good", 0.7, 2.34), ("fair", 0.4, 11.0)):
            put(trial_of(summary, label), "dynamic", "contact_foresight.foreseen", foreseen)
            put(trial_of(summary, label), "dynamic", "contact_foresight.needless_stops", stops)
        summary["headline"] = "contact_foresight.foreseen"

    page = opened_with(foresee, viewport={"width": width, "height": 900})
    figure = page.locator("#ranking")
    drawing = figure.locator("svg.figure-drawing")
    assert drawing.locator("text.beside").all_text_contents()[:2] == ["2.3", "11.0"]
    assert "Needless stops, 1/min" in drawing.locator("text").all_text_contents()
    assert drawing.evaluate(INSIDE) == []
    note = figure.locator(".note").inner_text()
    assert "On the right: Needless stops, 80 % foreseen, 1/min (lower is better)" in note
    assert "contact_foresight.needless_stops" in downloaded(page, "#ranking").splitlines()[0]
    figure.locator("select[data-choice=Reference]").select_option("fair")
    assert drawing.locator("text.beside").count() == 0
    assert drawing.locator("g title").first.text_content() == "good, Needless stops, 80 % foreseen, 1/min: 2.3"


@pytest.mark.parametrize(("high", "words"), [(0.57, "it is wide, of good 0.03 to 0.57 at 0.5 s ahead"), (0.1, "")])
def test_an_interval_over_most_of_a_figure_is_said_below_it(opened_with, high, words):
    def widen(summary):
        area = trial_of(summary, "good")["strata"]["in-motion"]["pr_auc"]["area"]
        area["low"], area["high"] = ([0.03] * len(area["value"]) for _ in range(2))
        area["high"][4] = high

    note = opened_with(widen).locator("#curves .note").inner_text()
    assert words in note
    assert ("it is wide" in note) == bool(words)


def test_a_row_with_general_weights_has_one_name(opened_with):
    """One row has weights of the site; floors do not say which weights they have."""

    def generalise(summary):
        for label, card in {"good": "general", "fair": "general", "unlucky": "site", "persistence": "general"}.items():
            trial_of(summary, label)["card"] = card

    page = opened_with(generalise)
    page.locator(".player[data-ready]").wait_for()
    page.get_by_label("wipe between the first two").check()
    page.get_by_role("button", name="most different of the first two").click()
    chips = page.locator("#trackers button").all_inner_texts()
    said = page.evaluate(SAID)
    assert {"good (general)", "fair (general)", "persistence"} <= set(chips)
    for label in ("good", "fair"):
        assert said.count(f"{label} (general)") > 10
        assert label not in said.replace(f"{label} (general)", "")
