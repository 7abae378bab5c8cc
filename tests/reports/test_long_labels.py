"""Long labels are shown whole at the width of a screen and of a telephone: in drawings, tables and facts."""

from contextlib import ExitStack
from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from gridtrack.reports.page import render_report

from scenes.edited_run import edit, trial_of
from scenes.report_page import opened
from scenes.synthetic_run import write_confusion

LONG = "new-dilated-convgru (general)"
LONGER = "a-label-that-somebody-wrote-to-tell-all-of-the-options-of-a-tracker-apart"
UNBROKEN = "NotASingleSignAtWhichALineCouldEndIsInThisLabel"
CLASSES = ["pedestrian", "cyclist", "car", "articulated lorry with a trailer", "static"]
WIDTHS = [1280, 400]


@pytest.fixture(scope="module")
def report(make_run, tmp_path_factory):
    """A report of three trackers with long labels and persistence, with times from 0.02 to 125 ms."""
    still = np.full((21, 32, 32), 0.1, np.float32)
    names = {"persistence": "persistence"} | dict.fromkeys((LONG, LONGER, UNBROKEN), "good-tracker")
    trackers = {label: (tracker, lambda _: still) for label, tracker in names.items()}
    run = make_run(tmp_path_factory.mktemp("runs") / "long", trackers)

    def add(summary):
        times = trial_of(summary, "persistence")["latency_ms"]
        times["update"] |= {"p50": 0.02, "p95": 0.02, "p99": 0.02, "twentieths": [0.02] * 21}
        summary["recordings"]["crossing"]["classes"] = CLASSES

    write_confusion(run / f"{LONG}@crossing", CLASSES, {8: [[5, 1, 0, 0, 0, 0]] * len(CLASSES)})
    return render_report([edit(run, add)])


@pytest.fixture(scope="module")
def open_wide(browser, report):
    """The page at a width, opened once; no test changes it."""
    with ExitStack() as pages:
        yield cache(
            lambda width: pages.enter_context(opened(browser, report, viewport={"width": width, "height": 900}))
        )


def boxes(page, selector):
    """The text and the place on the page of each element."""
    return page.locator(selector).evaluate_all(
        "all => all.map(one => { const { left, right, top, bottom } = one.getBoundingClientRect();"
        " return { text: one.textContent, left, right, top, bottom }; })"
    )


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("figure", ["ranking", "latency"])
def test_a_drawing_has_the_whole_label_beside_the_plot(open_wide, figure, width):
    page = open_wide(width)
    names = boxes(page, f"#{figure} .line > text:first-of-type")
    assert {name["text"] for name in names} == {"persistence", LONG, LONGER, UNBROKEN}
    plot = min(line["left"] for line in boxes(page, f"#{figure} line.grid, #{figure} circle.dot"))
    (drawing,) = boxes(page, f"#{figure} svg.figure-drawing")
    assert all(drawing["left"] - 1 <= name["left"] and name["right"] < plot for name in names)
    ticks = sorted(boxes(page, f"#{figure} svg > text.tick"), key=lambda tick: tick["left"])
    assert all(above["bottom"] <= below["top"] for above, below in pairwise([*names, *ticks[:1]]))
    assert all(left["right"] + 4 <= right["left"] for left, right in pairwise(ticks))


@pytest.mark.parametrize("width", WIDTHS)
def test_names_right_of_the_plot_are_whole_and_apart(open_wide, width):
    page = open_wide(width)
    names = sorted(boxes(page, "#score-and-time .line > text"), key=lambda name: name["top"])
    assert {name["text"] for name in names} == {"persistence", LONG, LONGER, UNBROKEN}
    (drawing,) = boxes(page, "#score-and-time svg.figure-drawing")
    plot = max(line["right"] for line in boxes(page, "#score-and-time line.grid"))
    assert all(plot < name["left"] and name["right"] <= drawing["right"] + 1 for name in names)
    assert all(above["bottom"] <= below["top"] for above, below in pairwise(names))
    assert names[-1]["bottom"] <= drawing["bottom"]


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("table", [".headline", "#every-score table"])
def test_a_table_has_the_whole_label_and_room_for_scores(open_wide, table, width):
    page = open_wide(width)
    cells = page.locator(f"{table} tbody th.name")
    assert all(cells.evaluate_all("all => all.map(one => one.scrollWidth <= one.clientWidth)"))
    assert all(cell["right"] - cell["left"] <= 0.6 * width for cell in boxes(page, f"{table} tbody th.name"))
    (short,) = [one for one in boxes(page, f"{table} .label") if one["text"] == "persistence"]
    assert short["bottom"] - short["top"] < 30  # one line


@pytest.mark.parametrize("width", WIDTHS)
def test_a_confusion_matrix_names_its_classes(open_wide, width):
    page = open_wide(width)
    names = boxes(page, "#confusion text.tick")
    shown = [name["text"] for name in names]
    assert [name for name in shown if name not in (*CLASSES, "other")] == [shown[3], shown[8]]
    assert all(name.endswith("…articulated lorry with a trailer") for name in (shown[3], shown[8])), "whole titles"
    (drawing,) = boxes(page, "#confusion svg.figure-drawing")
    for name in names:
        assert drawing["left"] - 1 <= name["left"] < name["right"] <= drawing["right"] + 1
        assert drawing["top"] - 1 <= name["top"]
    for left, right in pairwise(names[len(CLASSES) :]):
        assert left["right"] <= right["left"]
    cells = min(cell["top"] for cell in boxes(page, "#confusion rect.share"))
    assert all(name["bottom"] <= cells for name in names[len(CLASSES) :])
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
