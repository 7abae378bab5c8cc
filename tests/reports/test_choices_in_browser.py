"""Choices in the figures of a run: the time ahead lasts over recordings of unlike rates, and so does the score."""

import pytest

from gridtrack.reports.page import render_report

from scenes import synthetic_run as synthetic
from scenes.edited_run import with_again
from scenes.report_page import opened

PERIODS_S = {"fast": (0.05, 50), "slow": (0.2, 12), "uneven": (0.105263, 24)}
"""The period of each recording, and its steps: 1 s is step 20, step 5, and between 9 and 10: the even one."""
NAMES = "Recording", "Cells"
WITH_HORIZON = ["ranking", "scale", "precision-recall", "threshold", "calibration", "every-score"]


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    run = tmp_path_factory.mktemp("runs") / "unlike"
    trials = [
        synthetic.write_trial(run, label, recording, skill, seed=seed, frames=6, steps=steps)
        for seed, (recording, (_, steps)) in enumerate(PERIODS_S.items())
        for label, skill in {"persistence": 0.6, "good": 0.8}.items()
    ]
    described = {
        name: synthetic.description(period_s=period_s, steps=steps) for name, (period_s, steps) in PERIODS_S.items()
    }
    return render_report([synthetic.write_results(run, described, trials)])


@pytest.fixture
def page(browser, report):
    with opened(browser, report, viewport={"width": 1280, "height": 900}) as page:
        yield page


def ahead_of(page, figure):
    return page.locator(f"#{figure}").get_by_label("Ahead").locator("option:checked").inner_text()


def test_another_recording_has_the_chosen_time_ahead(page):
    for figure in WITH_HORIZON:
        assert ahead_of(page, figure) == "1 s", "at the start"
        for recording, ahead in {"slow": "1 s", "uneven": "1.05 s", "fast": "1 s"}.items():
            page.locator(f"#{figure}").get_by_label("Recording").select_option(recording)
            assert ahead_of(page, figure) == ahead, figure


def test_the_nearest_time_is_used_and_the_choice_comes_back(page):
    ranking = page.locator("#ranking")
    ranking.get_by_label("Recording").select_option("fast")
    ranking.get_by_label("Ahead").select_option("0.75 s")
    first = ranking.locator("svg").get_attribute("aria-label")
    ranking.get_by_label("Recording").select_option("slow")
    assert ahead_of(page, "ranking") == "0.8 s"
    ranking.get_by_label("Recording").select_option("fast")
    assert ahead_of(page, "ranking") == "0.75 s"
    assert ranking.locator("svg").get_attribute("aria-label") == first


def test_the_drawn_scores_belong_to_that_time(page):
    """Each step has other scores: the table of every score beside the ranking."""
    for figure in ("ranking", "every-score"):
        page.locator(f"#{figure}").get_by_label("Recording").select_option("slow")
    headings = page.locator("#every-score thead th").all_inner_texts()
    row = page.locator("#every-score tbody tr", has_text="good").locator("td").nth(headings.index("F1") - 1)
    page.locator("#ranking").get_by_label("Score").select_option("F1")
    drawn = page.locator("#ranking svg").get_attribute("aria-label")
    assert f"good {row.inner_text().split()[0]}" in drawn


def test_only_scores_with_a_direction_are_ranked(page):
    offered = page.locator("#ranking").get_by_label("Score").locator("option").all_inner_texts()
    assert {"PR-AUC", "F1", "Log loss, nats"} <= set(offered)
    without = {"Precision", "Recall", "Threshold", "Brier: resolution"}
    assert without.isdisjoint(offered)
    assert without <= set(page.locator("#curves").get_by_label("Score").locator("option").all_inner_texts())


def test_a_choice_that_another_recording_does_not_have_leaves_the_figure_whole(browser, run_folder, tmp_path):
    """Hidden cells are scored on one recording only."""
    run = with_again(run_folder, tmp_path / "run", lambda _, again: again.update(occluded=again["visible"]))
    with opened(browser, render_report([run])) as page:
        for figure in ("ranking", "curves", "every-score"):
            recording, cells = (page.locator(f'#{figure} .choice:has(span:text-is("{name}")) select') for name in NAMES)
            recording.select_option("again")
            cells.select_option("occluded")
            recording.select_option("crossing")
            assert cells.input_value() != "occluded"
            assert page.locator(f"#{figure} select:visible").count() >= 3


def without_scores(scores):
    """The scores of a stratum without cells: only its threshold."""
    undefined = {end: [None] * 21 for end in ("value", "low", "high")}
    return {score: dict.fromkeys(outputs, undefined) for score, outputs in scores.items()}


def test_cells_without_a_score_that_ranks_are_not_offered_and_leave_no_other_ranking(browser, run_folder, tmp_path):
    """A stratum of one recording has no cells, and another recording has none at all."""

    def empty(strata, again):
        again.update({name: without_scores(scores) for name, scores in strata.items()})
        strata["visible over 10 m"] = again["visible"]

    run = with_again(run_folder, tmp_path / "run", empty)
    with opened(browser, render_report([run])) as page:
        offered = page.locator("#ranking").get_by_label("Cells").locator("option").all_inner_texts()
        assert "visible cells" in offered
        assert "visible over 10 m cells" not in offered
        assert page.locator("#ranking .dot").count() > 1
        page.locator("#ranking").get_by_label("Recording").select_option("again")
        assert page.locator("#ranking .dot").count() == 0
        page.locator("#ranking").get_by_label("Recording").select_option("crossing")
        assert page.locator("#ranking .dot").count() > 1
