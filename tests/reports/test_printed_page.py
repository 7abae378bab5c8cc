"""A printed page describes its figures in words, as nothing can be chosen on paper."""

import pytest


@pytest.fixture
def printed(opened):
    page, _ = opened()
    page.locator("#curves").get_by_label("Score").select_option("F1")
    page.get_by_role("button", name="blank", exact=True).click()
    page.emulate_media(media="print")
    return page


def test_choices_and_lines_are_printed_on_paper(printed):
    reported = printed.locator("#curves .printed").inner_text()
    assert reported.startswith("Recording: crossing; Cells: in-motion cells; Score: F1")
    assert "good" in reported
    assert "persistence" in reported
    assert "blank" not in reported
    assert printed.locator("#curves .printed .swatch line").count() == 4
    assert "Ahead: 1 s" in printed.locator("#ranking .printed").inner_text()


def test_controls_are_not_printed(printed):
    assert printed.locator(".controls:visible").count() == 0
    assert printed.locator("#moments canvas").first.is_visible()


def test_on_a_screen_the_words_are_not_shown(opened):
    page, _ = opened()
    assert page.locator(".printed").count() > 3
    assert page.locator(".printed:visible").count() == 0
