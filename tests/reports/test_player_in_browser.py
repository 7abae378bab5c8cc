"""The player in a browser: every control, by pointer and by keyboard alone, without an error and without a request."""

import math
import re
from dataclasses import replace

import pytest

from gridtrack.evaluation.referee.samples import KeptObject, read_samples
from gridtrack.reports.page import render_report
from gridtrack.reports.scripts import json_in_page

from scenes.edited_run import with_again
from scenes.report_page import HOSTILE, moments_of

expect = pytest.importorskip("playwright.sync_api", reason="playwright, of the extra dev, is not installed").expect


def shows(page, moment, h):
    page.locator(f'.player[data-ready="{moment} {h}"]').wait_for()


def test_the_keyboard_alone_scrubs_and_plays(opened):
    page, player = opened()
    player.focus()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("ArrowUp")
    shows(page, 1, 2)
    page.keyboard.press("ArrowDown")
    shows(page, 1, 1)
    page.keyboard.press(" ")
    assert player.get_by_role("button", name="pause").count() == 1
    shows(page, 3, 1)
    page.keyboard.press(" ")
    assert player.get_by_role("button", name="play", exact=True).count() == 1


def test_sliders_and_buttons_have_names_and_work(opened):
    page, player = opened()
    page.get_by_role("slider", name="time").fill("5")
    page.get_by_role("slider", name="horizon").fill("0")
    shows(page, 5, 0)
    for words in ("worst of the first", "most different of the first two"):
        page.get_by_role("button", name=words).click()
        assert re.match(r"moment \d+ of 20(, the |: no )(worst|most different)", player.locator(".why").inner_text())
    page.get_by_label("tracker 3").select_option("none")
    page.get_by_label("tracker 4").select_option("none")
    assert player.locator(".moment-panel").count() == 4
    page.get_by_label("wipe between the first two").check()
    page.get_by_role("slider", name="wipe").fill("9")
    assert player.locator(".moment-panel").count() == 3
    page.get_by_label("hits and errors").uncheck()
    page.get_by_label("boxes").uncheck()
    page.get_by_label("zoom").select_option("twice")
    player.locator("canvas").first.click()


def test_the_jumps_are_of_the_trackers_on_screen_and_say_so(opened):
    page, player = opened()
    for at, name in enumerate(("good", "none", "persistence", "blank"), 1):
        page.get_by_label(f"tracker {at}").select_option(name)
    why, trackers = player.locator(".why"), page.locator("#trackers")
    page.get_by_role("button", name="most different of the first two").click()
    expect(why).to_have_text(re.compile(r"^moment \d+ of 20, the most different of good and persistence \+1 s$"))
    trackers.get_by_role("button", name="good", exact=True).click()
    page.get_by_role("button", name="worst of the first").click()
    expect(why).to_have_text(re.compile(r"^moment \d+ of 20, the worst of persistence \+1 s$"))
    page.get_by_role("slider", name="time").fill("4")
    expect(why).to_have_text("moment 5 of 20")
    trackers.get_by_role("button", name="persistence", exact=True).click()
    page.get_by_role("button", name="most different of the first two").click()
    expect(why).to_have_text("moment 5 of 20: too few trackers are shown")


def test_the_wipe_follows_the_pointer_on_the_picture(opened):
    page, player = opened()
    page.get_by_label("wipe between the first two").check()
    wiped = player.locator("canvas.wipes")
    wiped.scroll_into_view_if_needed()
    box = wiped.bounding_box()
    page.mouse.move(box["x"] + 0.25 * box["width"], box["y"] + 20)
    page.mouse.down()
    expect(page.get_by_role("slider", name="wipe")).to_have_value("8")
    page.mouse.move(box["x"] + 0.75 * box["width"], box["y"] + 20)
    expect(page.get_by_role("slider", name="wipe")).to_have_value("24")
    page.mouse.up()
    page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 20)
    expect(page.get_by_role("slider", name="wipe")).to_have_value("24")


COUNT_MARKS = """
canvas => {
  const context = canvas.getContext("2d"), cell = canvas.width / 32, found = {};
  for (let row = 0; row < 32; row += 1) for (let column = 0; column < 32; column += 1) {
    const at = [Math.floor((column + 0.15) * cell), Math.floor((row + 0.15) * cell)];
    const colour = context.getImageData(...at, 1, 1).data.slice(0, 3).join(" ");
    found[colour] = (found[colour] ?? 0) + 1;
  }
  return found;
}
"""


def test_the_marks_on_the_canvas_are_the_counts_beside_it(opened):
    page, player = opened()
    page.get_by_label("tracker 1").select_option("persistence")
    page.get_by_label("tracker 2").select_option("good")
    page.get_by_role("slider", name="time").fill("5")
    shows(page, 5, 1)
    for at, expected in ((2, [0, 3, 4]), (3, [4, 0, 0])):
        panel = player.locator(".moment-panel").nth(at)
        words = re.search(r"(\d+) hit, (\d+) false, (\d+) missed", panel.locator("small").inner_text())
        assert [int(count) for count in words.groups()] == expected
        found = panel.locator("canvas").evaluate(COUNT_MARKS)
        assert [found.get(colour, 0) for colour in ("0 92 175", "240 155 0", "205 20 85")] == expected


def test_a_link_opens_the_page_at_its_moment_even_of_a_hostile_name(opened):
    page, _ = opened()
    for at, name in enumerate((HOSTILE, "good", "none", "none"), 1):
        page.get_by_label(f"tracker {at}").select_option(name)
    page.get_by_role("slider", name="time").fill("7")
    page.get_by_role("slider", name="horizon").fill("2")
    shows(page, 7, 2)
    page, player = opened(page.evaluate("location.hash"))
    shows(page, 7, 2)
    assert page.get_by_label("tracker 1").locator("option:checked").inner_text() == HOSTILE
    assert player.locator(".moment-panel").count() == 4
    assert HOSTILE in player.locator(".moment-panel").nth(2).inner_text()


@pytest.mark.parametrize(
    "fragment", ["#t=nowhere,1,1", "#t=%E0%A4%A", "#t=crossing,x,y", "#other", "#ranking=no,such,score&hidden=nobody"]
)
def test_a_link_to_nothing_leaves_the_page_as_it_is(opened, fragment):
    page, _ = opened(fragment)
    shows(page, 0, 1)


BOX_COLOURS = """
canvas => {
  const { data, width } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  const found = [[], []];
  for (let at = 0; at < data.length; at += 4) {
    const [red, green, blue] = data.slice(at, at + 3);
    if (green <= red + 60 || green <= blue + 20) continue;
    found[0].push((at / 4) % width);
    found[1].push(Math.floor(at / 4 / width));
  }
  return found.map((places) => [Math.min(...places), Math.max(...places)].map((place) => 32 * (place + 0.5) / width));
}
"""


def test_a_box_lies_where_the_object_is_now_and_where_its_velocity_takes_it(opened, run_folder, tmp_path, monkeypatch):
    """A body 1 m long and 0.5 m wide at (-1, 1), along y, at 2 m/s to the right: cells of 0.2 m from (-3.2, 0)."""
    body = KeptObject(7, (-1.0, 1.0, math.pi / 2, 1.0, 0.5), (2.0, 0.0))
    monkeypatch.setattr(
        "gridtrack.reports.player.read_samples", lambda path: (replace(s, objects=(body,)) for s in read_samples(path))
    )
    page, _ = opened(report=render_report([run_folder], tmp_path))
    panels = page.locator(".player .moment-panel canvas")
    across, down = panels.nth(0).evaluate(BOX_COLOURS)
    assert across[0] == pytest.approx(11 - 1.25, abs=0.3)
    assert down[1] == pytest.approx(32 - 2.5, abs=0.3)
    across, down = panels.nth(2).evaluate(BOX_COLOURS)
    assert across[0] == pytest.approx(11 - 1.25, abs=0.3), "dashed, where it is now"
    assert across[1] >= 11 + 10 + 1.25 - 0.3, "1 s later, 2 m to the right"
    assert down[1] == pytest.approx(32 - 2.5, abs=0.3)


def test_a_wipe_has_the_objects_of_each_tracker_on_its_own_side(opened, run_folder, tmp_path, monkeypatch):
    """The body of the test above, of `good` alone: the wipe at column 16 is between where it is and where it goes."""
    body = KeptObject(7, (-1.0, 1.0, math.pi / 2, 1.0, 0.5), (2.0, 0.0))

    def of_good(path):
        return (replace(one, objects=(body,) if "good@" in str(path) else ()) for one in read_samples(path))

    monkeypatch.setattr("gridtrack.reports.player.read_samples", of_good)
    page, _ = opened(report=render_report([run_folder], tmp_path))
    page.get_by_label("wipe between the first two").check()
    for good_at, beside in ((1, 2), (2, 1)):
        page.get_by_label(f"tracker {good_at}").select_option("good")
        page.get_by_label(f"tracker {beside}").select_option("blank")
        expect(page.locator(".moment-panel span", has_text="good | " if good_at == 1 else " | good")).to_be_visible()
        across, down = page.locator("canvas.wipes").evaluate(BOX_COLOURS)
        assert down[1] == pytest.approx(32 - 2.5, abs=0.3)
        if good_at == 1:
            assert across == [pytest.approx(11 - 1.25, abs=0.3), pytest.approx(16, abs=0.3)]
        else:
            assert across[0] == pytest.approx(16, abs=0.3)
            assert across[1] >= 11 + 10 + 1.25 - 0.3


def test_a_tracker_that_the_page_hides_has_no_panel_and_is_in_no_menu(opened):
    page, player = opened()
    before = player.locator(".moment-panel").count()
    first, second = (page.get_by_label(f"tracker {at}").locator("option:checked") for at in (1, 2))
    switch = page.locator("#trackers").get_by_role("button", name="good", exact=True)
    switch.click()
    assert player.locator(".moment-panel").count() == before - 1
    assert first.inner_text() == "none"
    assert second.inner_text() != "none"
    assert page.get_by_label("tracker 2").locator("option", has_text=re.compile("^good$")).is_disabled()
    switch.click()
    assert player.locator(".moment-panel").count() == before
    assert first.inner_text() == "good"


RIGHT, HALF, WRONG, NOTHING = [4, 0, 0], [2, 2, 2], [0, 4, 4], [0, 0, 0]


@pytest.mark.parametrize(
    ("counts", "line"),
    [
        (
            {6: (RIGHT, HALF), 8: (RIGHT, WRONG), 9: (WRONG, WRONG)},
            "moment 9 of 20, the most different of {} and {} +1 s",
        ),
        ({6: (HALF, HALF), 9: (WRONG, WRONG)}, "moment 10 of 20, the worst of {} +1 s"),
        ({}, "moment 1 of 20"),
    ],
)
def test_the_player_opens_at_the_most_different_moment_else_the_worst_else_the_first(
    opened, run_folder, tmp_path, counts, line
):
    """A page with these counts of the first two trackers, by moment, and no motion at any other."""
    html = render_report([run_folder], tmp_path).read_text("utf-8")
    (data,) = moments_of(html)
    for at, moment in enumerate(data["moments"]):
        moment["counts"] = [[*counts.get(at, (NOTHING, NOTHING)), *row[2:]] for row in moment["counts"]]
    moments = re.search(r'id="moments-0">(.*?)</script>', html, re.DOTALL)[1]
    (tmp_path / "changed.html").write_text(html.replace(moments, json_in_page(data)))
    page, _ = opened(report=tmp_path / "changed.html")
    expect(page.locator(".player .why")).to_have_text(line.format(*data["trackers"]))


@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (400, "dark")])
def test_a_cell_is_large_nothing_is_cut_off_and_axe_finds_nothing_serious(opened, serious_findings, width, scheme):
    page, player = opened(width=width, color_scheme=scheme)
    assert player.locator("canvas").first.bounding_box()["width"] / 32 >= 4
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert serious_findings(page) == []


def test_every_figure_redraws_with_every_choice_and_reads_values_by_keyboard(opened):
    page, _ = opened()
    figures = page.locator("section.figure:has(.drawn)")
    assert figures.count() >= 7
    for figure in figures.all():
        for select in figure.locator(".choices select:visible").all():
            for value in select.evaluate("one => [...one.options].map((option) => option.value)"):
                select.select_option(value)
        assert figure.locator(".drawn > *").count() == 1
        chart = figure.locator(".chart")
        if chart.count():
            chart.focus()
            page.keyboard.press("ArrowRight")
            assert figure.locator(".readout span").count() >= 1


def test_without_scripts_one_still_picture_remains(browser, hostile_report):
    context = browser.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto(hostile_report.as_uri())
    assert page.locator(".still").is_visible()
    assert not page.locator(".player").is_visible()
    context.close()


@pytest.fixture
def two_recordings(run_folder, tmp_path):
    """The report of a run that has its recording a second time, as `again`."""
    return render_report([with_again(run_folder, tmp_path / "run")])


def test_another_recording_keeps_the_chosen_trackers_and_the_horizon(opened, two_recordings):
    page, _ = opened(report=two_recordings)
    page.get_by_label("tracker 1").select_option("blank")
    page.get_by_label("tracker 2").select_option("none")
    page.get_by_role("slider", name="horizon").fill("2")
    page.locator("#moments").get_by_label("Recording").select_option("again")
    player = page.locator(".player:visible[data-ready]")
    player.wait_for()
    chosen = player.locator(".menu select option:checked").all_text_contents()
    assert chosen[:4] == ["blank", "persistence", "blank", "none"]
    expect(player.locator(".slider output").nth(1)).to_have_text("+2 s")


def test_the_same_button_again_leads_to_such_a_moment_of_the_next_recording(opened, two_recordings):
    page, _ = opened(report=two_recordings)
    recording = page.locator("#moments").get_by_label("Recording")
    page.get_by_label("tracker 1").select_option("blank")
    for name in ("crossing", "again", "crossing"):
        worst = page.locator(".player:visible").get_by_role("button", name="worst of the first")
        worst.click()
        expect(recording).to_have_value(name)
        words = r"^moment \d+ of 20, the worst of blank \+1 s; again: of the next recording$"
        expect(page.locator(".player:visible .why")).to_have_text(re.compile(words))
        expect(page.locator(".player:visible").get_by_role("button", name="worst of the first")).to_be_focused()


def test_the_legend_has_the_cells_and_the_sensor_of_the_recording_on_screen(opened, two_recordings):
    """The second recording has cells of half the size, and its sensors are outside the window."""
    before, between, moments = two_recordings.read_text("utf-8").rpartition('"cell_m":0.2')
    moments = re.sub(r'"sensors":\[\[[^]]*\]\]', '"sensors":[[90.0,0.3]]', moments)
    two_recordings.write_text(before + between.replace("0.2", "0.1") + moments, "utf-8")
    page, _ = opened(report=two_recordings)
    legend = page.locator("#moments > .legend")
    recording = page.locator("#moments").get_by_label("Recording")
    first, second = ("crossing", "0.2 m, 6.4 m", 1), ("again", "0.1 m, 3.2 m", 0)
    for name, words, sensor in (first, second, first):
        recording.select_option(name)
        expect(legend).to_contain_text(f"32 × 32 cells of {words} across")
        expect(legend.get_by_text("sensor").filter(visible=True)).to_have_count(sensor)
