"""In the light and in the dark scheme a cell on screen has the colour that the legend beside it has, pixel by pixel."""

import io

import pytest

PIL = pytest.importorskip("PIL.Image", reason="pillow, of the extra dev, is not installed")
SIZE = 32
FREE, OCCUPIED, UNSEEN = (5, 26), (28, 26), (31, 26)
"""Row and column of cells that the moving block does not hide at the first moment."""


@pytest.fixture(scope="module", params=["light", "dark"])
def moments(browser, hostile_report, request):
    """The section of the moments of a page in one scheme, and the scheme."""
    page = browser.new_page(viewport={"width": 1280, "height": 2400}, color_scheme=request.param)
    page.set_default_timeout(60_000)
    page.goto(hostile_report.as_uri())
    page.locator(".player[data-ready]").wait_for()
    yield page.locator("#moments"), request.param
    page.close()


def show(section, moment):
    section.page.get_by_role("slider", name="time").fill(str(moment))
    section.page.locator(f'.player[data-ready="{moment} 1"]').wait_for()


def pixels(locator):
    return PIL.open(io.BytesIO(locator.screenshot())).convert("RGB")


def colour_at(picture, across, down):
    return picture.getpixel((int(across * picture.width), int(down * picture.height)))


def colour_of(picture, cell):
    row, column = cell
    return colour_at(picture, (column + 0.2) / SIZE, (SIZE - row - 0.8) / SIZE)


def near(one, other):
    return all(abs(a - b) <= 6 for a, b in zip(one, other, strict=True))


def test_the_input_has_the_colours_of_the_bar(moments):
    section, scheme = moments
    show(section, 0)
    bar = pixels(section.locator(".legend svg image").first)
    key = pixels(section.locator(".key.unobserved"))
    panel = pixels(section.locator("canvas").first)
    assert near(colour_of(panel, FREE), colour_at(bar, 0.015, 0.5))
    assert near(colour_of(panel, OCCUPIED), colour_at(bar, 0.985, 0.5))
    assert near(colour_of(panel, UNSEEN), colour_at(key, 0.5, 0.5))
    bright = sum(colour_of(panel, FREE)) > 3 * 128
    assert bright == (scheme == "light"), "free cells have the shade of the paper"


def test_a_hit_has_the_colour_of_its_key(moments):
    section, _ = moments
    section.page.get_by_label("tracker 1").select_option("good")
    show(section, 5)
    panel = section.locator(".moment-panel").nth(2)
    assert "4 hit" in panel.locator("small").inner_text()
    colours = pixels(panel.locator("canvas")).getcolors(1 << 20)
    key = colour_at(pixels(section.locator(".marks-legend .key").first), 0.5, 0.5)
    assert any(near(colour, key) for count, colour in colours if count > 100)


def test_no_mark_is_mistaken_for_a_cell_that_is_not_visible(moments):
    section, _ = moments
    unseen = colour_at(pixels(section.locator(".key.unobserved")), 0.5, 0.5)
    keys = section.locator(".marks-legend .key").all()
    colours = {key.evaluate("one => one.parentElement.textContent"): colour_at(pixels(key), 0.1, 0.5) for key in keys}
    apart = {name: sum((a - b) ** 2 for a, b in zip(colour, unseen, strict=True)) for name, colour in colours.items()}
    assert "hidden, not scored" in apart
    assert {name for name, squared in apart.items() if squared < 80**2} == set()
