"""The page by keyboard alone: every control can be reached, is then marked, and works as by pointer."""

CONTROLS = "button, select, input, a[href], summary, [tabindex='0']"
NUMBER_CONTROLS = f"""() => [...document.querySelectorAll("{CONTROLS}")].map((one, i) => {{
  one.dataset.control = i;
  return one.checkVisibility({{ visibilityProperty: true }}) && !one.disabled ? i : -1;
}}).filter((i) => i >= 0)"""
FOCUSED = """() => {
  const one = document.activeElement, style = getComputedStyle(one);
  const marked = style.outlineStyle !== "none" && parseFloat(style.outlineWidth) >= 1;
  return { control: Number(one.dataset?.control ?? -1), marked, tag: one.tagName };
}"""


def test_tab_reaches_every_control_and_marks_it(opened):
    page, _ = opened()
    wanted = page.evaluate(NUMBER_CONTROLS)
    assert len(wanted) > 50
    reached = []
    for _ in range(len(wanted) + 5):
        page.keyboard.press("Tab")
        focused = page.evaluate(FOCUSED)
        if focused["control"] in reached:
            break
        if focused["control"] >= 0:
            assert focused["marked"], page.evaluate("document.activeElement.outerHTML.slice(0, 200)")
            reached.append(focused["control"])
    missed = page.evaluate(
        "(missed) => missed.map((i) => document.querySelector(`[data-control='${i}']`).outerHTML.slice(0, 200))",
        sorted(set(wanted) - set(reached)),
    )
    assert missed == []


def test_space_toggles_a_tracker_everywhere_and_enter_downloads(opened):
    page, player = opened()
    page.get_by_role("button", name="good", exact=True).focus()
    panels, lines = player.locator(".moment-panel").count(), page.locator("#curves .line").count()
    page.keyboard.press(" ")
    assert player.locator(".moment-panel").count() == panels - 1
    assert page.locator("#curves .line").count() == lines - 1
    page.locator("#ranking").get_by_role("button", name="CSV").focus()
    with page.expect_download() as saved:
        page.keyboard.press("Enter")
    assert '"good"' not in saved.value.path().read_text()


def test_the_arrows_change_a_choice_and_the_figure_with_it(opened):
    page, _ = opened()
    before = page.locator("#curves .drawn").inner_html()
    select = page.locator("#curves .choices select:visible").first
    select.focus()
    chosen = select.input_value()
    page.keyboard.press("ArrowDown")
    assert page.locator("#curves .choices select:visible").first.input_value() != chosen
    assert page.locator("#curves .drawn").inner_html() != before
    assert page.evaluate("document.activeElement.tagName") == "SELECT", "the focus stays on the choice"


def test_enter_opens_the_explanation_of_a_figure_and_escape_closes_it(opened):
    page, _ = opened()
    button = page.locator("#ranking button.meaning")
    meaning = page.locator("#meaning-ranking")
    button.focus()
    page.keyboard.press("Enter")
    assert meaning.is_visible()
    assert "A bar joins rows that do not differ significantly" in meaning.inner_text()
    page.keyboard.press("Escape")
    assert not meaning.is_visible()
    assert page.evaluate("document.activeElement.textContent") == "Explanation"
