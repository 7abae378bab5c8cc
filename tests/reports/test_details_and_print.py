"""Less important figures are in a section that opens on demand; print shows all of it, with the choices as text."""

import pytest


@pytest.fixture
def page(browser, hostile_report):
    """The page with its details closed."""
    page = browser.new_page(viewport={"width": 1000, "height": 900})
    page.goto(hostile_report.as_uri())
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


def test_a_link_and_print_open_them(page):
    page.evaluate("location.hash = 'threshold'")
    page.locator("#threshold svg.figure-drawing").wait_for()
    page.locator("#details").evaluate("one => { one.open = false; }")
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    page.emulate_media(media="print")
    assert page.locator("#threshold svg.figure-drawing").is_visible()
    assert not page.locator("#details > summary").is_visible()


def test_print_shows_choices_and_legend_as_text_and_no_controls(opened):
    page, _ = opened()
    page.locator("#curves").get_by_label("Score").select_option("F1")
    page.get_by_role("button", name="blank", exact=True).click()
    assert page.locator(".printed").count() > 3
    assert page.locator(".printed:visible").count() == 0
    page.emulate_media(media="print")
    printed = page.locator("#curves .printed")
    words = printed.inner_text()
    assert words.startswith("Recording: crossing; Cells: in-motion cells; Score: F1")
    assert {name: name in words for name in ("good", "persistence", "blank")} == {
        "good": True, "persistence": True, "blank": False,
    }  # fmt: skip
    assert printed.locator(".swatch line").count() == 4
    assert "Ahead: 1 s" in page.locator("#ranking .printed").inner_text()
    assert page.locator(".controls:visible").count() == 0
    assert page.locator("#moments canvas").first.is_visible()
