"""A printed page says in words what its figures show, as nothing of it can be chosen on paper."""

import pytest


@pytest.fixture
def printed(opened):
    page, _ = opened()
    page.locator("#curves").get_by_label("Score").select_option("F1")
    page.get_by_role("button", name="blank", exact=True).click()
    page.emulate_media(media="print")
    return page


def test_what_is_chosen_and_the_lines_are_told_on_paper(printed):
    told = printed.locator("#curves .printed").inner_text()
    assert told.startswith("Recording: crossing; Cells: in-motion cells; Score: F1")
    assert "good" in told
    assert "persistence" in told
    assert "blank" not in told
    assert printed.locator("#curves .printed .swatch line").count() == 4
    assert "Ahead: 1 s" in printed.locator("#ranking .printed").inner_text()


def test_what_cannot_be_used_on_paper_is_not_printed(printed):
    assert printed.locator(".controls:visible").count() == 0
    assert printed.locator("#moments canvas").first.is_visible()


def test_on_a_screen_the_words_are_not_shown(opened):
    page, _ = opened()
    assert page.locator(".printed").count() > 3
    assert page.locator(".printed:visible").count() == 0
