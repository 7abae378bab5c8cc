"""The list of all kept moments sorts, filters and opens them; the address has what is chosen."""

import pytest

from gridtrack.reports.page import render_report

from scenes.edited_run import with_again
from scenes.report_page import downloaded


@pytest.fixture(scope="module")
def two_recordings(run_folder, tmp_path_factory):
    """The report of a run that has its recording a second time, as `again`."""
    return render_report([with_again(run_folder, tmp_path_factory.mktemp("list") / "run")])


@pytest.fixture
def listed(opened, two_recordings):
    page, _ = opened(report=two_recordings)
    page.get_by_text("All kept moments as a list").click()
    moments = page.locator(".all-moments")
    moments.get_by_label("Row").select_option("good")
    moments.get_by_label("Less").select_option("blank")
    return page, moments


def column(moments, number):
    return moments.locator(f"tbody tr > :nth-child({number})").all_text_contents()


def test_every_moment_is_listed_with_the_largest_difference_first(listed):
    _, moments = listed
    assert moments.locator("thead th").all_text_contents() == [
        "recording", "time, s", "F1 of good", "F1 of blank", "difference",
    ]  # fmt: skip
    differences = column(moments, 5)
    assert len(differences) == 40
    defined = [float(one) for one in differences if one != "–"]
    assert defined == sorted(defined, reverse=True)
    assert differences[len(defined) :] == ["–"] * (40 - len(defined)), "undefined ones are last"
    assert moments.locator("th[aria-sort]").all_text_contents() == ["difference"]


def test_a_heading_sorts_and_sorts_back(listed):
    page, moments = listed
    for words, order in (("descending", True), ("ascending", False)):
        page.get_by_role("button", name="time, s").click()
        assert moments.locator("th[aria-sort]").get_attribute("aria-sort") == words
        times = [float(one) for one in column(moments, 2)]
        assert times == sorted(times, reverse=order)
        assert page.evaluate("document.activeElement.textContent") == "time, s", "the focus stays"
    page.get_by_role("region", name="All kept moments").get_by_role("button", name="recording", exact=True).click()
    assert column(moments, 1) == ["again"] * 20 + ["crossing"] * 20


def test_the_list_is_filtered_by_recording_and_by_motion_and_saved(listed):
    page, moments = listed
    moments.get_by_label("Recording").select_option("again")
    assert column(moments, 1) == ["again"] * 20
    moments.locator("select").last.select_option("with 5 cells in motion or more")
    assert column(moments, 1) == [], "the block has four cells"
    moments.locator("select").last.select_option("all")
    lines = downloaded(page, ".all-moments").splitlines()
    assert (len(lines), lines[0].split(",")[0]) == (21, '"recording"')


def test_a_click_opens_the_moment_with_both_rows_in_the_player(listed):
    page, moments = listed
    row = moments.locator("tbody tr", has_text="again").nth(3)
    seconds = row.locator("td").first.text_content()
    row.get_by_role("button").click()
    player = page.locator(".player:visible")
    player.locator("output", has_text=f"{seconds} s").wait_for()
    assert player.get_attribute("aria-label") == "Moments of again"
    chosen = player.locator(".menu select option:checked").all_text_contents()
    assert chosen[:4] == ["good", "blank", "none", "none"]
    assert page.evaluate("location.hash").startswith("#t=again,")
    players = page.locator(".player")
    assert players.last.bounding_box()["y"] < moments.bounding_box()["y"], "a new player stands above the list"


def test_a_hidden_row_has_no_score_in_the_list(listed):
    page, moments = listed
    page.locator("#trackers").get_by_role("button", name="good", exact=True).click()
    assert set(column(moments, 3)) == {"–"}


def test_the_address_has_choices_rows_and_moment_and_is_copied(opened, hostile_report):
    page, _ = opened()
    assert page.evaluate("location.hash") == "", "nothing is chosen yet"
    page.locator("#ranking").get_by_label("Score").select_option("F1")
    page.locator("#ranking select:visible").first.select_option("visible cells")
    page.locator("#trackers").get_by_role("button", name="blank", exact=True).click()
    page.get_by_role("slider", name="time").fill("7")
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    page.get_by_role("button", name="copy link").click()
    page.get_by_role("button", name="copied").wait_for()
    copied = page.evaluate("navigator.clipboard.readText()")
    assert copied.startswith(hostile_report.as_uri() + "#")
    page, player = opened(copied.removeprefix(hostile_report.as_uri()))
    assert page.locator("#ranking select:visible option:checked").all_text_contents()[:2] == ["visible cells", "F1"]
    blank = page.locator("#trackers").get_by_role("button", name="blank", exact=True)
    assert blank.get_attribute("aria-pressed") == "false"
    assert page.locator("[data-tracker=blank]:visible").count() == 0
    player.locator(".why", has_text="moment 8 of 20").wait_for()


def test_a_link_that_is_entered_on_the_open_page_is_followed(opened):
    page, player = opened()
    page.evaluate("location.hash = 't=crossing,2.5,1,good'")
    player.locator(".why", has_text="moment 6 of 20").wait_for()
    page.evaluate("location.hash = 'hidden=blank&t=crossing,2.5,1,good'")
    blank = page.locator("#trackers").get_by_role("button", name="blank", exact=True)
    page.locator("#trackers button[aria-pressed=false]", has_text="blank").wait_for()
    assert blank.get_attribute("aria-pressed") == "false"
