"""Figures that matter less are in a part of the page that opens on demand, and is printed."""

import pytest

from gridtrack.reports.page import render_report


@pytest.fixture
def page(browser, run_folder):
    page = browser.new_page(viewport={"width": 1000, "height": 900})
    page.goto(render_report([run_folder]).as_uri())
    page.locator("#every-score table").wait_for()
    yield page
    page.close()


def test_details_are_named_and_open_by_keyboard_at_the_width_of_the_page(page):
    details = page.locator("#details")
    figures = details.locator("section.figure")
    titles = [title.lower() for title in figures.locator("h2").all_text_contents()]
    assert len(titles) >= 4
    assert details.locator("summary").inner_text() == f"Details: {', '.join(titles)}"
    assert not figures.first.is_visible()
    page.set_viewport_size({"width": 800, "height": 900})
    details.locator("summary").focus()
    page.keyboard.press("Enter")
    drawings = "[...document.querySelectorAll(':is(#curves, #details) svg.figure-drawing')]"
    page.wait_for_function(f"new Set({drawings}.map((one) => one.getBoundingClientRect().width)).size === 1")


def test_a_link_and_paper_open_them(page):
    page.evaluate("location.hash = 'threshold'")
    page.locator("#threshold svg.figure-drawing").wait_for()
    page.locator("#details").evaluate("one => { one.open = false; }")
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    page.emulate_media(media="print")
    assert page.locator("#threshold svg.figure-drawing").is_visible()
    assert not page.locator("#details > summary").is_visible()
