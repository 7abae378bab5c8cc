"""The first screen of the page: a moment of two trackers moves, and can be stopped."""

import pytest

from gridtrack.reports.page import render_report

from scenes.edited_run import edited
from scenes.report_page import data_of, moments_of, opened

PANELS = "#opening .moment-panel"


@pytest.fixture
def report(run_folder, tmp_path):
    return render_report([run_folder], tmp_path / "page")


def test_the_moment_of_the_first_screen_is_the_one_in_which_the_best_two_differ_most(report):
    page = report.read_text("utf-8")
    opening = data_of(page)["opening"]
    data = moments_of(page)[0]
    assert opening["trackers"] == ["good", "fair"]
    places = [data["trackers"].index(label) for label in opening["trackers"]]

    def difference(moment):  # no moment has five occupied cells
        (tp, fp, fn), (own_tp, own_fp, own_fn) = (moment["counts"][data["decisive"]][place] for place in places)
        f1 = [2 * tp / max(2 * tp + fp + fn, 1), 2 * own_tp / max(2 * own_tp + own_fp + own_fn, 1)]
        return abs(f1[0] - f1[1])

    assert difference(data["moments"][opening["moment"]]) == max(map(difference, data["moments"]))


def test_a_single_row_has_no_moment_on_the_first_screen(run_folder, tmp_path):
    def only_good(summary):
        summary["trackers"] = {"good": summary["trackers"]["good"]}

    page = render_report([edited(run_folder, tmp_path / "run", only_good)]).read_text("utf-8")
    assert data_of(page)["opening"] is None


def test_the_moment_moves_until_it_is_stopped_and_opens_in_the_player(browser, report):
    with opened(browser, report) as page:
        page.locator(f"{PANELS} canvas").first.wait_for()
        assert page.locator(f"{PANELS} figcaption span").all_inner_texts() == ["input", "observed", "good", "fair"]
        ahead = page.locator("#opening output")
        first = ahead.inner_text()
        page.wait_for_function("(first) => document.querySelector('#opening output').textContent !== first", arg=first)
        page.locator("#opening").get_by_role("button", name="pause").click()
        assert page.locator("#opening").get_by_role("button", name="play").count() == 1
        page.locator("#opening").get_by_role("button", name="open this moment").click()
        assert page.evaluate("location.hash").startswith("#t=crossing,")
        page.get_by_role("button", name="fair", exact=True).click()
        assert page.locator(PANELS, has_text="fair").is_hidden()


def test_the_moment_stands_still_where_the_user_wants_less_motion(browser, report):
    page = browser.new_page(reduced_motion="reduce")
    page.goto(report.as_uri())
    page.locator("#opening").get_by_role("button", name="play").wait_for()
    page.close()
