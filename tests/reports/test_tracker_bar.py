"""The bar of trackers stays small however many there are, and never hides a focused element or a target."""

import pytest

NAME = "a-label-that-somebody-wrote-to-tell-all-of-the-options-of-a-tracker-apart"
MANY = f"""bar => {{
  const one = bar.querySelector("button");
  for (let i = 0; i < 20; i += 1) {{
    const more = one.cloneNode(true);
    more.lastChild.textContent = "{NAME}-" + i;
    bar.append(more);
  }}
}}"""
COVERED = """() => {
  const bar = document.getElementById("trackers"), one = document.activeElement;
  const below = bar.getBoundingClientRect(), own = one.getBoundingClientRect();
  const stuck = !bar.contains(one) && below.top <= 1 && own.height < 300;
  return stuck && own.top < below.bottom - 1 && own.bottom > below.top ? one.outerHTML.slice(0, 120) : "";
}"""
WIDTHS = [(1280, 110), (400, 64)]


@pytest.fixture(params=WIDTHS, ids=["wide", "narrow"])
def crowded(opened, request):
    """A page with 20 more buttons with long names, and the most that its bar may take, pixels."""
    width, most = request.param
    page, _ = opened(width=width)
    page.locator("#trackers").evaluate(MANY)
    return page, most


def test_twenty_long_names_leave_the_page_its_room(crowded):
    page, most = crowded
    assert page.locator("#trackers").bounding_box()["height"] <= most
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    last = page.locator("#trackers button").last
    last.focus()
    box = last.bounding_box()
    bar = page.locator("#trackers").bounding_box()
    assert bar["y"] <= box["y"]
    assert box["y"] + box["height"] <= bar["y"] + bar["height"] + 1


def test_a_control_that_is_focused_backwards_is_not_below_the_bar(crowded):
    page, _ = crowded
    page.locator("details summary").last.focus()
    covered = []
    while not page.evaluate("document.getElementById('trackers').contains(document.activeElement)"):
        page.keyboard.press("Shift+Tab")
        covered.append(page.evaluate(COVERED))
        assert len(covered) < 200
    assert len(covered) > 40
    assert [one for one in covered if one] == []


def test_a_heading_that_is_jumped_to_is_below_the_bar(crowded):
    page, _ = crowded
    for figure in ("curves", "moments", "threshold", "every-score"):
        page.evaluate(f"location.hash = '{figure}'")
        page.wait_for_function(f"Math.abs(document.getElementById('{figure}').getBoundingClientRect().top) < 250")
        heading = page.locator(f"#{figure} > h2").bounding_box()
        bar = page.locator("#trackers").bounding_box()
        assert heading["y"] >= bar["y"] + bar["height"]
