"""A row with general weights has one name on the whole page: in the bar of trackers, tables, figures and the player.

It says so beside a tracker with weights of the site; floors do not."""

from gridtrack.reports.page import render_report

from scenes.edited_run import edited, trial_of
from scenes.report_page import opened

SAID = """() => {
  document.querySelectorAll(".facts, script").forEach((one) => one.remove());
  const of = (name) => [...document.querySelectorAll(`[${name}]`)].map((one) => one.getAttribute(name));
  const options = [...document.querySelectorAll("option, svg text, svg title")].map((one) => one.textContent);
  return [document.querySelector("main").innerText, ...of("aria-label"), ...options].join("\\n");
}"""


def test_a_row_with_general_weights_has_one_name(browser, run_folder, tmp_path):
    def generalise(summary):
        for label, card in {"good": "general", "fair": "general", "unlucky": "site", "persistence": "general"}.items():
            trial_of(summary, label)["card"] = card

    with opened(browser, render_report([edited(run_folder, tmp_path / "run", generalise)])) as page:
        page.locator(".player[data-ready]").wait_for()
        page.get_by_label("wipe between the first two").check()
        page.get_by_role("button", name="most different of the first two").click()
        chips = page.locator("#trackers button").all_inner_texts()
        said = page.evaluate(SAID)
    assert {"good (general)", "fair (general)", "persistence"} <= set(chips)
    for label in ("good", "fair"):
        assert said.count(f"{label} (general)") > 10
        assert label not in said.replace(f"{label} (general)", "")
